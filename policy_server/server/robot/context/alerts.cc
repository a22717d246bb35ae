#include "policy_server/server/robot/context/alerts.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/cut_text.h"

namespace rips::pipeline {

void Alerts::Raise(engine::Severity severity, const std::string& text, std::source_location where) {
  RaiseOfKind(absl::StrCat(where.file_name(), ":", where.line()), severity, text);
}

bool Alerts::RaiseOfKind(const std::string& kind, engine::Severity severity,
                         const std::string& text, const std::string& event,
                         engine::SharedTrace trace) {
  engine::AlertEffect alert{.rule = std::string(kOwnRule),
                            .severity = severity,
                            .text = Shortened(text, kOwnAlertBytesMax),
                            .level = level_.level(),
                            .decision_id = level_.decision_id(),
                            .trace = std::move(trace)};
  if (!own_.Admit(kind, alert, context_.now())) return false;
  Add(std::move(alert), event);
  return true;
}

void Alerts::RaiseFolded(FoldedAlerts folded, const std::string& text, const std::string& event,
                         engine::SharedTrace trace) {
  folded.alert.text = Shortened(text, kOwnAlertBytesMax);
  folded.alert.trace = std::move(trace);
  Add(std::move(folded.alert), event);
}

void Alerts::RaiseAbsence(const std::string& text, std::source_location where) {
  const std::string kind = absl::StrCat(where.file_name(), ":", where.line());
  const std::string mark = maintenance_.MarkAt(context_.now());
  if (mark.empty()) {
    RaiseOfKind(kind, engine::Severity::kHigh, text);
    return;
  }
  RaiseOfKind(absl::StrCat(kind, " in maintenance"), engine::Severity::kInfo,
              absl::StrCat(text, "; ", mark));
}

void Alerts::RaiseOfRule(const engine::AlertEffect& alert, const std::string& event) {
  if (!rules_.Admit(alert, context_.now())) return;
  Add(alert, alert.graph_truncated ? absl::StrCat(event, " (graph truncated)") : event);
}

void Alerts::Summarize() {
  for (AlertLimiter* limiter : {&rules_, &own_}) {
    for (engine::AlertEffect& summary : limiter->Due(context_.now())) Add(std::move(summary), "");
  }
}

void Alerts::Add(engine::AlertEffect alert, const std::string& event) {
  const std::string id = context_.ids.Next();
  if (alert.severity >= engine::Severity::kHigh && context_.moment.recorded) {
    context_.Do(action::KeepRecording{{.id = id,
                                       .rule = alert.rule,
                                       .severity = alert.severity,
                                       .text = alert.text,
                                       .time_unix_ns = context_.now().unix_ns}});
  }
  const bool kept = outbox_.AddAlert({.id = id,
                                      .time_unix_ns = context_.now().unix_ns,
                                      .robot = context_.config.id,
                                      .rule = std::move(alert.rule),
                                      .severity = std::string(engine::ToString(alert.severity)),
                                      .text = Shortened(alert.text, kAlertTextBytesMax),
                                      .level = level_.table().name(alert.level),
                                      .event = Shortened(event, kAlertEventBytesMax),
                                      .decision_id = alert.decision_id,
                                      .maintenance = maintenance_.MarkAt(context_.now()),
                                      .trace = CopyOf(alert.trace)});
  if (!kept) context_.Count(Counter::kAlertsLost);
  context_.Count(Counter::kAlerts);
}

}  // namespace rips::pipeline
