#include "policy_server/server/operator_api/alert_acks.h"

#include <algorithm>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/state/effect.h"
#include "policy_server/server/operator_api/record_codec.h"
#include "services/base/status_macros.h"

namespace rips::operator_api {
namespace {

constexpr engine::Severity kSeverities[] = {engine::Severity::kInfo, engine::Severity::kLow,
                                            engine::Severity::kMedium, engine::Severity::kHigh,
                                            engine::Severity::kCritical};
constexpr uint64_t kNanosPerMilli = 1'000'000;

// The one alert whose id begins so.
absl::StatusOr<store::AlertRecord> FindAlert(const std::string& prefix, store::Store& store) {
  if (!IsIdPrefix(prefix)) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", absl::CHexEscape(prefix), "` is no id of an alert: that is ", kIdDigits,
                     " lower-case hex digits, or the first ", kIdDigitsMin, " at least"));
  }
  RIPS_ASSIGN_OR_RETURN(store::FoundRecords found, store.FindRecords(prefix));
  if (found.alerts.empty()) return store::NoSuchAlert(prefix);
  if (found.alerts.size() == 1) return std::move(found.alerts.front());
  return absl::InvalidArgumentError(absl::StrCat(
      "the ids of several alerts begin with ", prefix, ", among them ", found.alerts[0].id, " and ",
      found.alerts[1].id, "; give more digits; none was acknowledged"));
}

}  // namespace

rips::v1::Acknowledgement Encode(const store::Ack& ack) {
  rips::v1::Acknowledgement out;
  out.set_by(ack.by);
  out.set_time_unix_ns(ack.time_unix_ns);
  out.set_note(ack.note);
  return out;
}

absl::StatusOr<store::AlertQuery> DecodeAlertQuery(const rips::v1::ListAlertsRequest& request,
                                                   int64_t now_unix_ns) {
  store::AlertQuery query{.robot = request.robot(),
                          .limit = request.limit(),
                          .open = request.open(),
                          .rule = request.rule()};
  const uint64_t since_epoch_ms =
      static_cast<uint64_t>(std::max<int64_t>(now_unix_ns, 0)) / kNanosPerMilli;
  if (request.within_ms() > 0 && request.within_ms() < since_epoch_ms) {
    query.since_unix_ns = now_unix_ns - static_cast<int64_t>(request.within_ms() * kNanosPerMilli);
  }
  if (request.severity().empty()) return query;
  for (const engine::Severity severity : kSeverities) {
    const std::string name(engine::ToString(severity));
    if (name == request.severity() || !query.severities.empty()) query.severities.push_back(name);
  }
  if (!query.severities.empty()) return query;
  return absl::InvalidArgumentError(
      absl::StrCat("`", absl::CHexEscape(request.severity()),
                   "` is no severity; write info, low, medium, high or critical"));
}

absl::Status NoAcks() { return absl::UnimplementedError("no acknowledgements are kept"); }

absl::StatusOr<store::AlertList> ListAlertsOf(const store::AlertQuery& query, store::Store& store,
                                              store::AckStore* acks) {
  if (acks != nullptr) return acks->SearchAlerts(query);
  RIPS_ASSIGN_OR_RETURN(std::vector<store::AlertRecord> alerts,
                        store.ListAlerts(query.robot, query.limit));
  return store::AlertList{.alerts = std::move(alerts)};
}

absl::StatusOr<AcksById> AcksOf(const std::vector<store::AlertRecord>& alerts,
                                store::AckStore* acks) {
  AcksById by_id;
  if (acks == nullptr) return by_id;
  std::vector<std::string> ids;
  for (const store::AlertRecord& alert : alerts) ids.push_back(alert.id);
  RIPS_ASSIGN_OR_RETURN(std::vector<store::AckRecord> found, acks->FindAcks(ids));
  for (store::AckRecord& record : found) by_id[record.alert_id] = std::move(record.ack);
  return by_id;
}

absl::Status AddAcks(store::AckStore* acks, rips::v1::ExplainResponse& response) {
  if (acks == nullptr) return absl::OkStatus();
  const auto add = [acks](rips::v1::Alert& alert) -> absl::Status {
    RIPS_ASSIGN_OR_RETURN(const std::vector<store::AckRecord> found,
                          acks->FindAcks({&alert.id(), 1}));
    if (!found.empty()) *alert.mutable_acknowledged() = Encode(found.front().ack);
    return absl::OkStatus();
  };
  if (response.has_alert()) RIPS_RETURN_IF_ERROR(add(*response.mutable_alert()));
  for (rips::v1::Alert& alert : *response.mutable_alerts()) RIPS_RETURN_IF_ERROR(add(alert));
  return absl::OkStatus();
}

absl::StatusOr<AckPlan> AckPlan::Make(const rips::v1::AckAlertsRequest& request, std::string by,
                                      int64_t now_unix_ns, store::Store& store,
                                      store::AckStore& acks) {
  if (request.alert_ids().empty()) {
    return absl::InvalidArgumentError("the id of an alert is required");
  }
  AckPlan plan;
  plan.ack_ = {.by = std::move(by), .note = request.note(), .time_unix_ns = now_unix_ns};
  for (const std::string& prefix : request.alert_ids()) {
    RIPS_ASSIGN_OR_RETURN(store::AlertRecord alert, FindAlert(prefix, store));
    const auto same = [&alert](const auto& known) { return known.id == alert.id; };
    if (std::none_of(plan.alerts_.begin(), plan.alerts_.end(), same)) {
      plan.alerts_.push_back(std::move(alert));
    }
  }
  RIPS_ASSIGN_OR_RETURN(plan.before_, AcksOf(plan.alerts_, &acks));
  return plan;
}

store::WriteBatch AckPlan::ToWrite() const {
  store::WriteBatch batch{.robot = std::string(store::kServerRobot)};
  for (const store::AlertRecord& alert : alerts_) {
    if (!before_.contains(alert.id)) {
      batch.acks.push_back({.alert_id = alert.id,
                            .ack = ack_,
                            .robot = alert.robot,
                            .rule = alert.rule,
                            .severity = alert.severity});
    }
  }
  return batch;
}

absl::Status AckPlan::Answer(store::AckStore& acks, rips::v1::AckAlertsResponse& response) const {
  RIPS_ASSIGN_OR_RETURN(const AcksById now, AcksOf(alerts_, &acks));
  for (const store::AlertRecord& alert : alerts_) {
    const auto stands = now.find(alert.id);
    if (stands == now.end()) return store::NoSuchAlert(alert.id);
    rips::v1::AckedAlert& out = *response.add_alerts();
    out.set_alert_id(alert.id);
    *out.mutable_acknowledged() = Encode(stands->second);
    out.set_already(before_.contains(alert.id) || stands->second != ack_);
    out.set_robot(alert.robot);
    out.set_rule(alert.rule);
  }
  return absl::OkStatus();
}

}  // namespace rips::operator_api
