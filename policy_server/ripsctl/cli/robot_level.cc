#include "policy_server/ripsctl/cli/robot_level.h"

#include <nlohmann/json.hpp>

#include "policy_server/ripsctl/cli/command.h"
#include "policy_server/ripsctl/cli/printer.h"

namespace rips::ripsctl {

absl::StatusOr<v1::GetLevelResponse> ReadLevel(Env& env, const std::string& robot) {
  v1::GetLevelRequest request;
  request.set_robot(robot);
  return Call(env, &Stub::GetLevel, request);
}

Table StatusTable(const v1::RobotStatus& status) {
  Table table({"robot", EscapeText(status.robot())});
  table.Add({"decided level", status.decided_level()});
  table.Add({"effective level", status.effective_level()});
  table.Add({"stage", status.stage()});
  table.Add({"decision", DecisionIdText(status.decision_id())});
  return table;
}

void PrintDryRun(absl::string_view robot, const v1::LevelResponse& found, bool refused,
                 absl::string_view margin, std::ostream& out) {
  for (const std::string& why : found.blind_because()) {
    out << margin << "blind: " << EscapeText(why) << "\n";
  }
  if (refused) {
    out << margin << "would be refused, because RIPS does not see all of " << EscapeText(robot)
        << " now; --accept-blind lowers it all the same\n";
  }
  for (const std::string& rule : found.would_raise_again()) {
    out << margin << "would be raised again by rule " << EscapeText(rule) << kRaisedWhen << "\n";
  }
  out << margin << "not tried: rules on messages and on external events; the next one may raise "
      << EscapeText(robot) << " again\n";
}

Json NotTried() { return {"rules Msg", "rules External"}; }

}  // namespace rips::ripsctl
