#include "policy_server/server/operator_api/alert_acks.h"

#include <algorithm>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/operator_api/record_codec.h"
#include "services/base/status_macros.h"

namespace rips::operator_api {
namespace {

// The whole id of the one alert whose id begins so.
absl::StatusOr<std::string> WholeId(const std::string& prefix, store::Store& store) {
  if (!IsIdPrefix(prefix)) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", absl::CHexEscape(prefix), "` is no id of an alert: that is ", kIdDigits,
                     " lower-case hex digits, or the first ", kIdDigitsMin, " at least"));
  }
  RIPS_ASSIGN_OR_RETURN(const store::FoundRecords found, store.FindRecords(prefix));
  if (found.alerts.empty()) return store::NoSuchAlert(prefix);
  if (found.alerts.size() == 1) return found.alerts.front().id;
  return absl::InvalidArgumentError(
      absl::StrCat("the ids of several alerts begin with ", prefix, "; give more digits"));
}

}  // namespace

rips::v1::Acknowledgement Encode(const store::Ack& ack) {
  rips::v1::Acknowledgement out;
  out.set_by(ack.by);
  out.set_time_unix_ns(ack.time_unix_ns);
  out.set_note(ack.note);
  return out;
}

absl::StatusOr<rips::v1::AckAlertsResponse> AckAlerts(const rips::v1::AckAlertsRequest& request,
                                                      store::Ack ack, store::Store& store,
                                                      store::AckStore& acks) {
  if (request.alert_ids().empty()) {
    return absl::InvalidArgumentError("the id of an alert is required");
  }
  std::vector<std::string> ids;
  for (const std::string& prefix : request.alert_ids()) {
    RIPS_ASSIGN_OR_RETURN(std::string id, WholeId(prefix, store));
    if (std::find(ids.begin(), ids.end(), id) == ids.end()) ids.push_back(std::move(id));
  }
  ack.note = request.note();
  RIPS_ASSIGN_OR_RETURN(const std::vector<store::AckRecord> stand, acks.Acknowledge(ids, ack));
  rips::v1::AckAlertsResponse response;
  for (const store::AckRecord& record : stand) {
    rips::v1::AckedAlert& alert = *response.add_alerts();
    alert.set_alert_id(record.alert_id);
    *alert.mutable_acknowledged() = Encode(record.ack);
    alert.set_already(record.already);
  }
  return response;
}

absl::StatusOr<std::map<std::string, store::Ack>> AcksOf(
    const std::vector<store::AlertRecord>& alerts, store::AckStore& acks) {
  std::vector<std::string> ids;
  for (const store::AlertRecord& alert : alerts) ids.push_back(alert.id);
  RIPS_ASSIGN_OR_RETURN(std::vector<store::AckRecord> found, acks.FindAcks(ids));
  std::map<std::string, store::Ack> by_id;
  for (store::AckRecord& record : found) by_id[record.alert_id] = std::move(record.ack);
  return by_id;
}

}  // namespace rips::operator_api
