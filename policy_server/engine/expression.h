// The value of one typed expression.
#ifndef RIPS_POLICY_SERVER_ENGINE_EXPRESSION_H_
#define RIPS_POLICY_SERVER_ENGINE_EXPRESSION_H_

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/engine/builtins.h"
#include "policy_server/engine/program.h"
#include "policy_server/engine/scalar.h"
#include "policy_server/engine/topic_verdicts.h"
#include "policy_server/lang/checked_rules.h"
#include "policy_server/levels/level_table.h"

namespace rips::engine {

// Where the values of a program's variables stand, by the program's own index.
class Variables {
 public:
  // Of the program in force.
  explicit Variables(const std::vector<lang::Value>* values) : values_(values) {}
  // Of an older one: each stands somewhere else.
  explicit Variables(std::vector<const lang::Value*> places) : places_(std::move(places)) {}

  // Null if there is no such variable.
  const lang::Value* Find(uint32_t index) const {
    if (values_ != nullptr) return index < values_->size() ? &(*values_)[index] : nullptr;
    return index < places_.size() ? places_[index] : nullptr;
  }

 private:
  const std::vector<lang::Value>* values_ = nullptr;
  std::vector<const lang::Value*> places_;
};

// What expressions of one rule are evaluated on. Borrows all of it.
struct Context {
  const Program& program;
  const lang::TypedRule& rule;
  const Scene& scene;
  // Of the scene's topic under `program`; null: predicates are decided afresh.
  const TopicVerdict* verdict = nullptr;
  const Variables& variables;
  // `CurrLevel`, in the program's table, and `Level`.
  levels::LevelIndex level = 0;
  absl::string_view level_name;
  int64_t time_ns = 0;
  int64_t uptime_ns = 0;
  size_t string_max = 0;
};

// Evaluates left to right. Truth of `a && b` and `a || b` (T true, F false, ! fault, - not
// evaluated):
//
//   a  b  a && b  a || b        a  b  a && b  a || b        a  b  a && b  a || b
//   T  T  T       T             F  -  F                     !  -  !       !
//   T  F  F       T             F  T          T
//   T  !  !       T (b -)       F  F          F
//                               F  !  F (b -) !
//
// A fault in any other operand that is evaluated is a fault of the whole.
class Expression {
 public:
  // `context` outlives this.
  explicit Expression(const Context& context) : context_(context) {}

  // Nullopt on a fault. Text lives as long as this and until a variable is set.
  std::optional<Scalar> Eval(const lang::TypedExpr& expr);

  // Of the last Eval that faulted, for people.
  absl::string_view fault() const { return fault_; }
  // A string was longer than string_max and has been cut.
  bool cut() const { return cut_; }

 private:
  std::optional<Scalar> EvalOperand(const lang::TypedExpr& expr);
  std::optional<Scalar> EvalPredefined(lang::Predefined name) const;
  std::optional<Scalar> EvalUnary(const lang::TypedExpr& expr);
  std::optional<Scalar> EvalCall(const lang::TypedExpr& expr);
  std::optional<Scalar> Apply(lang::BinaryOp op, const Scalar& left, const Scalar& right);
  std::optional<Scalar> ApplyInt(lang::BinaryOp op, int64_t left, int64_t right);
  std::optional<Scalar> Concat(absl::string_view left, absl::string_view right);
  std::optional<Scalar> ToText(const Scalar& value);
  // Keeps `text`, cut to the limit.
  Scalar Keep(std::string text);
  std::nullopt_t Fault(absl::string_view what) {
    fault_ = what;
    return std::nullopt;
  }

  const Context& context_;
  // Views point into the strings, which therefore stay where they are.
  std::vector<std::unique_ptr<const std::string>> texts_;
  absl::string_view fault_;
  bool cut_ = false;
};

// The value, owning its text; and the inverse, a view of `value`.
lang::Value Own(const Scalar& scalar);
Scalar View(const lang::Value& value);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_ENGINE_EXPRESSION_H_
