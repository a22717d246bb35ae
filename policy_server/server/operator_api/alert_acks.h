// Acknowledgements of alerts, as operators ask for them and see them. What blocks, does so on the
// disk.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ALERT_ACKS_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ALERT_ACKS_H_

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/server/store/ack_store.h"
#include "policy_server/server/store/store.h"
#include "rips/v1/operator.pb.h"

namespace rips::operator_api {

using AcksById = std::map<std::string, store::Ack>;

rips::v1::Acknowledgement Encode(const store::Ack& ack);

// InvalidArgument for a severity that there is not. `now_unix_ns`: the end of `within_ms`.
absl::StatusOr<store::AlertQuery> DecodeAlertQuery(const rips::v1::ListAlertsRequest& request,
                                                   int64_t now_unix_ns);

// Unimplemented.
absl::Status NoAcks();

// By the index if `acks` is null: the query then has no condition but the robot. Blocks.
absl::StatusOr<store::AlertList> ListAlertsOf(const store::AlertQuery& query, store::Store& store,
                                              store::AckStore* acks);

// By id of the alert, those that there are; none if `acks` is null. Blocks.
absl::StatusOr<AcksById> AcksOf(const std::vector<store::AlertRecord>& alerts,
                                store::AckStore* acks);

// To the alerts of an explanation; nothing if `acks` is null. Blocks.
absl::Status AddAcks(store::AckStore* acks, rips::v1::ExplainResponse& response);

// What becomes of one request.
class AckPlan {
 public:
  // Finds the alerts, and which are acknowledged already. InvalidArgument for what is no id, or
  // begins several, which it names; NotFound, naming it, if an alert is not kept. Blocks.
  static absl::StatusOr<AckPlan> Make(const rips::v1::AckAlertsRequest& request, std::string by,
                                      int64_t now_unix_ns, store::Store& store,
                                      store::AckStore& acks);

  // What is to be written; empty = all are acknowledged already.
  store::WriteBatch ToWrite() const;
  // Once it is written: what stands. An alert that another operator acknowledged in between has
  // that one. NotFound if an alert was forgotten in between. Blocks.
  absl::Status Answer(store::AckStore& acks, rips::v1::AckAlertsResponse& response) const;

 private:
  store::Ack ack_;
  // Each once, in the order of the request.
  std::vector<store::AlertRecord> alerts_;
  AcksById before_;
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ALERT_ACKS_H_
