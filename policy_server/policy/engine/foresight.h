// What the rules of a robot would do with its level as things are now. Pure; changes nothing.
//
// Graph rules are asked on the graph as it is, External rules as at the next tick. Msg rules judge
// messages, which are not known before they come.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_FORESIGHT_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_FORESIGHT_H_

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/policy/engine/state/trace.h"
#include "policy_server/policy/levels/level_table.h"
#include "services/base/clock.h"

namespace rips::engine {

// Names of the Graph rules, in order, whose expression would be true if the robot were at `level`,
// and one of whose chains holds a trigger above it: "what would raise it again". Then those of the
// External rules. Whether the chain gets that far is not said.
std::vector<std::string> WouldRaise(levels::LevelIndex level, Instant now, const RobotState& state);

// A rule that asks for the next less restrictive level.
struct LoweringRule {
  std::string name;
  // Its condition is true now; none of a Msg rule.
  std::optional<bool> holds;
  // What its condition is made of; of a Msg rule, where it stands and its condition only.
  Trace trace;
};

inline constexpr size_t kLoweringRulesMax = 8;

// Rules that may leave the robot's level downwards, as WouldRaise otherwise, Msg rules last; none
// at a level that is not soft. At most kLoweringRulesMax.
std::vector<LoweringRule> LoweringRules(Instant now, const RobotState& state);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_FORESIGHT_H_
