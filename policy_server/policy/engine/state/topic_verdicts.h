// What can be said of rules from the topic and its types alone, decided once per topic.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TOPIC_VERDICTS_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TOPIC_VERDICTS_H_

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/functional/function_ref.h"
#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "policy_server/policy/engine/builtins/builtins.h"
#include "policy_server/policy/engine/state/compiled.h"

namespace rips::engine {

struct TopicVerdict {
  // By index of Compiled::predicates.
  std::vector<bool> holds;
  // Message rules that may fire or fault on this topic, in file order.
  std::vector<uint32_t> rules;
  // Those of them that hold an inspection.
  std::vector<uint32_t> inspecting;
  // How far back one of them counts the messages of the topic, and of one writer; 0 = none does.
  int64_t topic_window_ns = 0;
  int64_t sender_window_ns = 0;
};

struct Predicate;
// Does the predicate hold of the scene?
bool Holds(const Predicate& predicate, const EvalContext& scene);

// True for an operator that may divide by zero: the only fault that a condition can have.
bool MayDivideByZero(const lang::TypedExpr& expr);

// What is known of a call beforehand; nullopt = nothing.
using KnownCall = absl::FunctionRef<std::optional<bool>(const lang::TypedExpr& call)>;

// True if `condition` is false whatever happens where `known` is so, and cannot fault.
bool NeverFires(const lang::TypedExpr& condition, KnownCall known);
// Where nothing is known.
bool NeverFires(const lang::TypedExpr& condition);

// Remembers verdicts of one program. Not thread-safe. Anybody on the robot can make up topic names,
// so past a limit everything is forgotten and decided anew.
class TopicVerdicts {
 public:
  static constexpr size_t kTopicsMax = 4'096;
  // Sum of the lengths of TopicVerdict::rules.
  static constexpr size_t kRulesMax = 1 << 20;
  // Topics with more types, or a longer name, are not remembered.
  static constexpr size_t kTypesMax = 8;
  static constexpr size_t kNameBytesMax = 1'024;

  // `program` must be the same at each call since Clear(). Valid until the next change of
  // generation(); that of a topic that is not remembered until the next call.
  const TopicVerdict& For(const CompiledPolicy& program, const EvalContext& scene);
  void Clear();
  static bool Remembers(const EvalContext& scene);

  // Changes when verdicts that were handed out are no longer valid.
  uint64_t generation() const { return generation_; }

  // Topics remembered; distinct verdicts remembered.
  size_t topics() const { return topics_.size(); }
  size_t verdicts() const { return verdicts_.size(); }

 private:
  struct Known {
    std::vector<std::string> types;
    const TopicVerdict* verdict = nullptr;
  };

  absl::flat_hash_map<std::string, Known> topics_;
  // Topics about which every predicate answers the same share one.
  absl::flat_hash_map<std::vector<bool>, std::unique_ptr<const TopicVerdict>> verdicts_;
  size_t rules_ = 0;
  uint64_t generation_ = 0;
  // The last one that is not remembered.
  TopicVerdict passing_;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TOPIC_VERDICTS_H_
