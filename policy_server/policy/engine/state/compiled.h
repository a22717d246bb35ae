// What the engine derives from checked rules once per policy. Immutable, shared between threads.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_COMPILED_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_COMPILED_H_

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "policy_server/policy/engine/builtins/scalar.h"
#include "policy_server/policy/engine/state/code.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "re2/re2.h"
#include "re2/set.h"

namespace rips::engine {

// A call with constant arguments.
struct Predicate {
  lang::Builtin builtin = lang::Builtin::kTopicIn;
  // View the rules.
  std::vector<Scalar> args;
  // topicmatches only.
  std::unique_ptr<const RE2> regex;
};

// All patterns of `topicmatches` at once.
class Patterns {
 public:
  // Patterns below which searching one by one is as fast.
  static constexpr size_t kWorthwhile = 8;
  // Memory of all patterns and of the automaton that searches them.
  static constexpr int64_t kBytesMax = int64_t{64} << 20;

  void Add(absl::string_view pattern, uint32_t predicate);
  // After the last Add.
  void Seal();
  // Sets `holds` of every pattern found in `topic`. False, and nothing set, if it cannot tell:
  // there are few patterns, or they need too much memory together.
  bool Search(absl::string_view topic, std::vector<bool>& holds) const;

 private:
  std::vector<std::string> patterns_;
  std::vector<uint32_t> predicates_;
  std::unique_ptr<RE2::Set> set_;
};

// What a rule's expression asks for beyond the event.
struct RuleNeeds {
  bool inspects = false;
  // It alerts or decides a level: why it fired is recorded.
  bool tells = false;
  // Those in arguments of its actions.
  std::vector<uint32_t> argument_inspections;
  // 0 = it does not count.
  int64_t topic_window_ns = 0;
  int64_t sender_window_ns = 0;
};

struct CompiledPolicy::Compiled {
  // Indices of the rules of each class that are not constantly false, in file order.
  std::vector<uint32_t> message_rules;
  std::vector<uint32_t> graph_rules;
  std::vector<uint32_t> external_rules;

  // How far back any message rule counts; 0 = none does.
  int64_t topic_window_ns = 0;
  int64_t sender_window_ns = 0;

  // By index of the rule.
  std::vector<const EvalNode*> conditions;
  std::vector<RuleNeeds> needs;
  // Arguments of actions.
  absl::flat_hash_map<const lang::TypedExpr*, const EvalNode*> arguments;
  Code code;

  // What depends on the topic and its types alone; equal calls share one.
  std::vector<Predicate> predicates;
  absl::flat_hash_map<const lang::TypedExpr*, uint32_t> predicate_of;
  Patterns patterns;
  // What depends on the topic and on who is on it in the graph.
  std::vector<Predicate> facts;
  // What depends on the graph alone.
  std::vector<Predicate> graph;

  absl::flat_hash_map<std::string, uint32_t> variable_of;
  // Variables that are handed to trigger: they hold a position in the level table.
  std::vector<bool> holds_level;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_COMPILED_H_
