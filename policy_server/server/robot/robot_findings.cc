// Robot: what sensors find whatever the rules say.
#include <algorithm>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/server/robot/robot.h"

namespace rips::pipeline {
namespace {

std::string Text(const FindingSeen& finding) {
  std::string text = absl::StrCat("finding ", finding.kind);
  if (!finding.node.empty()) absl::StrAppend(&text, ", node ", finding.node);
  if (!finding.topic.empty()) absl::StrAppend(&text, ", topic ", finding.topic);
  if (!finding.guid.none()) absl::StrAppend(&text, ", GUID ", ToString(finding.guid));
  if (!finding.detail.empty()) absl::StrAppend(&text, ": ", finding.detail);
  return text;
}

// One that rules can ask for.
bool IsKindOfRules(absl::string_view kind) {
  const auto words = lang::SignatureOf(lang::Builtin::kFinding).parameters[0].words;
  return std::find(words.begin(), words.end(), kind) != words.end();
}

}  // namespace

bool Robot::TakeFinding(const std::string& host_name, const std::string& incarnation,
                        const FindingSeen& finding) {
  const Instant now = ports_.clock->Now();
  switch (findings_.Take(host_name, incarnation, finding, now.boottime_ns)) {
    case FindingRegistry::News::kKnown:
      return false;
    case FindingRegistry::News::kEnds:
      ports_.audience->OnRuleLog(config_.id, std::string(kOwnRule),
                                 absl::StrCat("no longer: ", Text(finding)));
      return false;
    case FindingRegistry::News::kBegins:
    case FindingRegistry::News::kTooMany:
      break;
  }
  const engine::AlertEffect alert = {
      .rule = std::string(kOwnRule),
      .severity = engine::Severity::kHigh,
      .text = absl::StrCat("sensor ", host_name, ": ", Text(finding)),
      .level = state_.level.level(),
      .decision_id = state_.level.decision_id()};
  // A sensor may make kinds up, and each kind has its own limit.
  const bool listed = IsKindOfRules(finding.kind);
  if (own_alert_limiter_.Admit(listed ? absl::StrCat("finding ", finding.kind) : "finding", alert,
                               now)) {
    Alert(alert, absl::StrCat("finding ", finding.kind));
  }
  return listed;
}

void Robot::ExpireFindings(Instant now) {
  for (const FindingSeen& finding : findings_.Expire(now.boottime_ns)) {
    ports_.audience->OnRuleLog(
        config_.id, std::string(kOwnRule),
        absl::StrCat("not told again by a restarted sensor: ", Text(finding)));
  }
}

}  // namespace rips::pipeline
