#include "policy_server/server/operator_api/record_codec.h"

#include <algorithm>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/model/robot_config.h"
#include "policy_server/server/store/trace_codec.h"
#include "services/base/cut_text.h"
#include "services/base/decision_id.h"
#include "services/base/status_macros.h"
#include "services/model_proto/decision_id_codec.h"

namespace rips::operator_api {
namespace {

// Of one firing of a rule: their traces are equal.
constexpr int kSameFiringMax = 16;

struct Found {
  std::optional<store::AlertRecord> alert;
  std::optional<store::TransitionRecord> transition;
};

absl::StatusOr<Found> FindById(const std::string& id, store::Store& store) {
  if (!IsIdPrefix(id)) {
    return absl::InvalidArgumentError(absl::StrCat("an id is ", kIdDigits,
                                                   " lower-case hex digits, or the first ",
                                                   kIdDigitsMin, " at least"));
  }
  RIPS_ASSIGN_OR_RETURN(store::FoundRecords found, store.FindRecords(id));
  const size_t count = found.alerts.size() + found.transitions.size();
  if (count == 0) {
    return absl::NotFoundError(
        absl::StrCat("no alert or level change with the id ", id, " is kept"));
  }
  if (count > 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("several ids begin with ", id, "; give more digits"));
  }
  Found out;
  if (!found.alerts.empty()) out.alert = std::move(found.alerts.front());
  if (!found.transitions.empty()) out.transition = std::move(found.transitions.front());
  return out;
}

absl::StatusOr<Found> FindByDecisionId(const std::string& robot, const DecisionId& decision_id,
                                       store::Store& store) {
  RIPS_ASSIGN_OR_RETURN(std::vector<store::TransitionRecord> newest,
                        store.ListTransitions(robot, store::kListMax));
  for (store::TransitionRecord& record : newest) {
    if (record.refused || record.decision_id != decision_id) continue;
    Found out;
    out.transition = std::move(record);
    return out;
  }
  return absl::NotFoundError(absl::StrCat("robot `", robot, "` has no decision ",
                                          ToString(decision_id), " among its newest ",
                                          store::kListMax));
}

// When the finding ended, by the first of `alerts` that says so from `time_unix_ns` on; 0 = none
// does. `alerts`: newest first.
int64_t EndOf(const model::Finding& finding, int64_t time_unix_ns,
              const std::vector<store::AlertRecord>& alerts) {
  model::Finding end = finding;
  end.over = true;
  int64_t ended = 0;
  for (const store::AlertRecord& each : alerts) {
    if (each.time_unix_ns >= time_unix_ns && each.trace.finding == end) ended = each.time_unix_ns;
  }
  return ended;
}

}  // namespace

bool IsIdPrefix(absl::string_view id) {
  return id.size() >= kIdDigitsMin && id.size() <= kIdDigits &&
         std::all_of(id.begin(), id.end(), [](char c) {
           return absl::ascii_isdigit(static_cast<unsigned char>(c)) || (c >= 'a' && c <= 'f');
         });
}

rips::v1::Alert Encode(const store::AlertRecord& alert) {
  rips::v1::Alert out;
  out.set_id(alert.id);
  out.set_time_unix_ns(alert.time_unix_ns);
  out.set_robot(alert.robot);
  out.set_rule(alert.rule);
  out.set_severity(alert.severity);
  // A store may be older than these limits.
  out.set_text(Shortened(alert.text, pipeline::kAlertTextBytesMax));
  out.set_level(alert.level);
  out.set_event(Shortened(alert.event, pipeline::kAlertEventBytesMax));
  out.set_maintenance(alert.maintenance);
  model_proto::Encode(alert.decision_id, *out.mutable_decision_id());
  for (const engine::TracedSubject& subject : alert.trace.subjects) {
    *out.add_subjects() = store::EncodeSubject(subject);
  }
  return out;
}

rips::v1::Transition Encode(const store::TransitionRecord& record) {
  rips::v1::Transition out;
  out.set_id(record.id);
  out.set_robot(record.robot);
  out.set_time_unix_ns(record.time_unix_ns);
  out.set_from(record.from);
  out.set_to(record.to);
  out.set_cause(record.cause);
  out.set_reason(record.reason);
  if (!record.refused) model_proto::Encode(record.decision_id, *out.mutable_decision_id());
  out.set_refused(record.refused);
  out.set_count(static_cast<uint32_t>(std::min<uint64_t>(record.count, UINT32_MAX)));
  out.set_stage(record.stage);
  out.set_detail(record.detail);
  return out;
}

absl::StatusOr<rips::v1::ExplainResponse> Explain(const rips::v1::ExplainRequest& request,
                                                  store::Store& store) {
  const bool by_id = !request.id().empty();
  if (by_id == !request.robot().empty()) {
    return absl::InvalidArgumentError("explain takes an id, or a robot and a decision");
  }
  const DecisionId decision_id = model_proto::Decode(request.decision_id());
  RIPS_ASSIGN_OR_RETURN(const Found found,
                        by_id ? FindById(request.id(), store)
                              : FindByDecisionId(request.robot(), decision_id, store));
  rips::v1::ExplainResponse response;
  if (found.alert) *response.mutable_alert() = Encode(*found.alert);
  if (found.transition) *response.mutable_transition() = Encode(*found.transition);
  const engine::Trace& trace = found.alert ? found.alert->trace : found.transition->trace;
  if (!trace.none()) *response.mutable_evidence() = store::EncodeTrace(trace);
  if (trace == engine::Trace{}) return response;

  const std::string& robot = found.alert ? found.alert->robot : found.transition->robot;
  const std::string& id = found.alert ? found.alert->id : found.transition->id;
  // Of records newest first, in the order of time.
  const auto add_same_firing = [&](const auto& records, auto* out) {
    for (auto record = records.rbegin(); record != records.rend(); ++record) {
      if (record->id == id || record->trace != trace) continue;
      if (out->size() < kSameFiringMax) *out->Add() = Encode(*record);
    }
  };
  RIPS_ASSIGN_OR_RETURN(const auto alerts, store.ListAlerts(robot, store::kListMax));
  if (trace.has_finding()) {
    *response.mutable_finding() = store::EncodeFinding(trace.finding);
    const int64_t time = found.alert ? found.alert->time_unix_ns : found.transition->time_unix_ns;
    response.set_finding_ended_unix_ns(EndOf(trace.finding, time, alerts));
  }
  if (trace.none()) return response;
  add_same_firing(alerts, response.mutable_alerts());
  RIPS_ASSIGN_OR_RETURN(const auto transitions, store.ListTransitions(robot, store::kListMax));
  add_same_firing(transitions, response.mutable_transitions());
  return response;
}

}  // namespace rips::operator_api
