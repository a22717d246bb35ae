#include "policy_server/server/robot/sight/findings.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/check/signature.h"

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

bool Findings::OnFinding(const std::string& host, const std::string& incarnation,
                         const FindingSeen& finding) {
  switch (registry_.Apply(host, incarnation, finding, context_.now_ns())) {
    case FindingRegistry::News::kKnown:
      return false;
    case FindingRegistry::News::kEnds:
      context_.Do(
          action::LogRule{std::string(kOwnRule), absl::StrCat("no longer: ", Text(finding))});
      return false;
    case FindingRegistry::News::kBegins:
    case FindingRegistry::News::kTooMany:
      break;
  }
  // A sensor may make kinds up, and each kind has its own limit.
  const bool listed = IsKindOfRules(finding.kind);
  const std::string event = absl::StrCat("finding ", finding.kind);
  alerts_.RaiseOfKind(listed ? event : "finding", engine::Severity::kHigh,
                      absl::StrCat("sensor ", host, ": ", Text(finding)), event);
  return listed;
}

void Findings::OnIncarnation(const std::string& host, const std::string& incarnation) {
  registry_.OnIncarnation(host, incarnation, context_.now_ns());
}

void Findings::Expire() {
  for (const FindingSeen& finding : registry_.Expire(context_.now_ns())) {
    context_.Do(
        action::LogRule{std::string(kOwnRule),
                        absl::StrCat("not told again by a restarted sensor: ", Text(finding))});
  }
}

}  // namespace rips::pipeline
