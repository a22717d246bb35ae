// Acknowledgements of alerts, as operators ask for them and see them.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ALERT_ACKS_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ALERT_ACKS_H_

#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/server/store/ack_store.h"
#include "policy_server/server/store/store.h"
#include "rips/v1/operator.pb.h"

namespace rips::operator_api {

rips::v1::Acknowledgement Encode(const store::Ack& ack);

// As rips/v1/operator.proto says of AckAlerts; the note is the request's, who and when are of
// `ack`. `store` and `acks` are of the same alerts. Blocks on the disk.
absl::StatusOr<rips::v1::AckAlertsResponse> AckAlerts(const rips::v1::AckAlertsRequest& request,
                                                      store::Ack ack, store::Store& store,
                                                      store::AckStore& acks);

// By id, those of these alerts that there are. Blocks on the disk.
absl::StatusOr<std::map<std::string, store::Ack>> AcksOf(
    const std::vector<store::AlertRecord>& alerts, store::AckStore& acks);

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ALERT_ACKS_H_
