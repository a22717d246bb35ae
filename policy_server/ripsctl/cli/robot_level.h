// A robot's level, as several commands read it and speak of it.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_ROBOT_LEVEL_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_ROBOT_LEVEL_H_

#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/ripsctl/cli/env.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

// `lowering_rules`: with the rules that may lower it.
absl::StatusOr<v1::GetLevelResponse> ReadLevel(Env& env, const std::string& robot,
                                               bool lowering_rules = false);

// The first rows of what there is to say of one robot.
Table StatusTable(const v1::RobotStatus& status);

// Rules on the graph are evaluated when it changes.
inline constexpr absl::string_view kRaisedWhen = " at the next change of the graph, not before";
// What an operator should know of a lowering that is in force, one line each.
void PrintWarnings(const v1::LevelResponse& found, TextStream out);
// What waits for a second operator, in one line; to be escaped.
std::string PendingText(absl::string_view robot, const v1::PendingApproval& pending);
// What rules may do to the level now, to be escaped; empty if it is the lowest, or not known.
std::string LoweringByRulesText(const v1::GetLevelResponse& now);
// `true now`, `false now`, `judges messages`
std::string HoldsText(const v1::LoweringRule& rule);
// `maintenance until 18:20 UTC (carol)`; empty if the robot is in none. To be escaped.
std::string MaintenanceText(const v1::RobotStatus& status);
// `verified`; and how many lowerings wait for a second operator.
std::string StageAndPending(const v1::RobotStatus& status);
// What a dry run of a lowering found, one line each behind `margin`. `refused`: RIPS is blind, and
// the operator has not accepted that. `not_tried`: the name of a rule that such a run leaves out.
void PrintDryRun(absl::string_view robot, const v1::LevelResponse& found, bool refused,
                 absl::string_view margin, TextStream out, absl::string_view not_tried = "");
// Which rules a dry run does not try, for JSON.
Json NotTried();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_ROBOT_LEVEL_H_
