#include "policy_server/ripsctl/cli/robot_level.h"

#include <nlohmann/json.hpp>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/command.h"
#include "policy_server/ripsctl/cli/printer.h"

namespace rips::ripsctl {

absl::StatusOr<v1::GetLevelResponse> ReadLevel(Env& env, const std::string& robot,
                                               bool lowering_rules) {
  v1::GetLevelRequest request;
  request.set_robot(robot);
  request.set_lowering_rules(lowering_rules);
  return Call(env, &Stub::GetLevel, request);
}

Table StatusTable(const v1::RobotStatus& status) {
  Table table({"robot", EscapeText(status.robot())});
  table.Add({"decided level", status.decided_level()});
  table.Add({"effective level", status.effective_level()});
  table.Add({"stage", StageAndPending(status)});
  table.Add({"decision", DecisionIdText(status.decision_id())});
  if (status.has_maintenance()) {
    table.Add({"maintenance",
               absl::StrCat(MaintenanceText(status), ": ", status.maintenance().reason())});
  }
  return table;
}

std::string MaintenanceText(const v1::RobotStatus& status) {
  if (!status.has_maintenance()) return "";
  // A day or less ahead; the name is enough here. JSON has date and certificate.
  const std::string& who = status.maintenance().operator_();
  return absl::StrCat(
      "maintenance until ",
      absl::FormatTime("%H:%M UTC", absl::FromUnixNanos(status.maintenance().until_unix_ns()),
                       absl::UTCTimeZone()),
      " (", who.substr(0, who.find(" (")), ")");
}

std::string LoweringByRulesText(const v1::GetLevelResponse& now) {
  if (!now.has_rules_cannot_lower_because()) return "";
  const std::string& why = now.rules_cannot_lower_because();
  return why.empty() ? "may lower it when their conditions hold"
                     : absl::StrCat("cannot lower it now: ", why);
}

std::string HoldsText(const v1::LoweringRule& rule) {
  if (!rule.has_holds()) return "judges messages";
  return rule.holds() ? "true now" : "false now";
}

std::string StageAndPending(const v1::RobotStatus& status) {
  if (status.pending_approvals() == 0) return status.stage();
  return absl::StrCat(status.stage(), "; ", status.pending_approvals(),
                      status.pending_approvals() == 1 ? " lowering waits" : " lowerings wait",
                      " for a second operator");
}

std::string PendingText(absl::string_view robot, const v1::PendingApproval& pending) {
  // The name is enough here; JSON has the certificate.
  const std::string& who = pending.operator_();
  return absl::StrCat(ShortId(pending.id()), ": operator ", who.substr(0, who.find(" (")),
                      " asked at ", ShortTime(pending.asked_unix_ns()), " to lower ", robot,
                      " from ", pending.from(), " to ", pending.to(),
                      pending.accept_blind() ? ", though the server may not see all of it" : "",
                      "; until ", ShortTime(pending.expires_unix_ns()), ": ", pending.reason(),
                      pending.changes().empty()
                          ? ""
                          : absl::StrCat("; since then: ", absl::StrJoin(pending.changes(), ", ")));
}

void PrintWarnings(const v1::LevelResponse& found, TextStream out) {
  for (const std::string& why : found.blind_because()) out << "blind: " << EscapeText(why) << "\n";
  for (const std::string& rule : found.would_raise_again()) {
    out << "may be raised again by rule " << EscapeText(rule) << kRaisedWhen << "\n";
  }
}

void PrintDryRun(absl::string_view robot, const v1::LevelResponse& found, bool refused,
                 absl::string_view margin, TextStream out, absl::string_view not_tried) {
  for (const std::string& why : found.blind_because()) {
    out << margin << "blind: " << EscapeText(why) << "\n";
  }
  if (refused) {
    out << margin << "would be refused, because RIPS does not see all of " << EscapeText(robot)
        << " now; --accept-blind lowers it all the same\n";
  }
  if (found.needs_approval()) {
    out << margin << "would wait for a second operator to approve it\n";
  }
  for (const std::string& rule : found.would_raise_again()) {
    out << margin << "would be raised again by rule " << EscapeText(rule) << kRaisedWhen << "\n";
  }
  out << margin << "not tried: rules on messages and on external events";
  if (!not_tried.empty()) out << " (" << EscapeText(not_tried) << " is one)";
  out << "; the next of those may raise " << EscapeText(robot) << " again\n";
}

Json NotTried() { return {"rules Msg", "rules External"}; }

}  // namespace rips::ripsctl
