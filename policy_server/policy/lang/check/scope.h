// The names that a program declares: one flat scope.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_CHECK_SCOPE_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_CHECK_SCOPE_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/policy/lang/diagnostic/diagnostic_sink.h"
#include "policy_server/policy/lang/syntax/ast.h"

namespace rips::lang {

struct Symbol {
  enum class Kind {
    kConstant,  // levels too
    kSet,
    kVariable,
    kBroken,  // its declaration is wrong, which has been reported
  };
  Kind kind = Kind::kBroken;
  // kConstant: kLevel when the initialiser is a level. kVariable: the declared type.
  ValueType type = ValueType::kInt;
  Value value;                       // kConstant
  std::vector<std::string> members;  // kSet
  uint32_t variable = 0;             // kVariable: index
};

class Scope {
 public:
  // `sink` is not owned and outlives this.
  explicit Scope(DiagnosticSink& sink) : sink_(sink) {}

  // False, and reported, if the name is taken by the program or by the language. A name of the
  // language that its first users did not have may be taken over, with a note.
  bool Declare(const ast::Name& name, Symbol symbol);

  // Null if not declared (yet).
  const Symbol* Find(absl::string_view name) const;

  // Names that will be declared further on, for hints only.
  void ExpectLater(absl::string_view name) { later_.emplace(name); }
  bool DeclaredLater(absl::string_view name) const {
    return later_.contains(name) && Find(name) == nullptr;
  }

  // Ordered.
  std::vector<absl::string_view> names() const;

 private:
  DiagnosticSink& sink_;
  absl::btree_map<std::string, Symbol> symbols_;
  absl::flat_hash_set<std::string> later_;
};

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_CHECK_SCOPE_H_
