// Effect: what a rule asks for. Returned by the evaluator, performed by its caller. `set` and the
// level decision have already been applied to RobotState.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_EFFECT_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_EFFECT_H_

#include <cstdint>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "policy_server/policy/engine/state/trace.h"
#include "policy_server/policy/levels/transition.h"

namespace rips::engine {

enum class Severity { kInfo, kLow, kMedium, kHigh, kCritical };
absl::string_view ToString(Severity severity);

struct AlertEffect {
  std::string rule;
  Severity severity = Severity::kMedium;
  std::string text;
  // Level and decision when it was raised.
  levels::LevelIndex level = 0;
  DecisionId decision_id;
  // Its rule fired because what was left out of the graph might make it true.
  bool graph_truncated = false;
  // Why the rule fired; null if it did not, or fired too often in this second to be traced.
  SharedTrace trace = {};
};

// A decision, or a refusal seen for the first time or again (`count` > 1: the same refusal of the
// same rule, from, to and reason; the record is updated, not added).
struct TransitionEffect {
  levels::Transition transition;
  uint64_t count = 1;
  // As of an alert.
  SharedTrace trace = {};
};

// Run a program on the robot. The result goes to OnProgramResult(run_id).
struct RunProgramEffect {
  uint64_t run_id = 0;
  std::string rule;
  std::string program;
  std::vector<std::string> args;
};

// An exec that was not asked of the robot; the action failed.
struct RefusedProgram {
  std::string rule;
  std::string program;
  // "late" | "too many in flight"
  std::string reason;
};

// A rule called True or False, to show values to whoever debugs it.
struct LogEffect {
  std::string rule;
  std::string text;
};

using Effect = std::variant<AlertEffect, TransitionEffect, RunProgramEffect, LogEffect>;

struct Outcome {
  // In the order they happened.
  std::vector<Effect> effects;
  // Variables changed: the checkpoint must be written.
  bool variables_changed = false;
  // Rules whose expression was true.
  uint32_t fired = 0;
  // Rules that faulted.
  uint32_t faults = 0;
  // Rules that did not fire because the recording does not hold what they ask.
  uint32_t undecidable = 0;
  // Rules whose value depended on an inspection that was not told, or on what was left out of the
  // graph.
  uint32_t unscanned = 0;
  // Nodes of expressions that were evaluated, each at most once in one call.
  uint64_t steps = 0;
  // A rule called `crash`: RobotState::halted() from now on.
  bool crashed = false;
  std::vector<RefusedProgram> refused_programs;
  // Names of rules that cut an over-long string for the first time under this policy.
  std::vector<std::string> cut_strings;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_EFFECT_H_
