// What actuators answered, as operators get it.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECEIPT_CODEC_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECEIPT_CODEC_H_

#include <cstddef>
#include <cstdint>
#include <vector>

#include "policy_server/server/robot/actuators/drill_run.h"
#include "policy_server/server/robot/actuators/receipt_history.h"
#include "policy_server/server/store/records.h"
#include "rips/v1/operator.pb.h"

namespace rips::operator_api {

// Texts must be UTF-8, as receipt_history.h makes them.
void Encode(const pipeline::LoggedReceipt& receipt, rips::v1::ReceivedReceipt* out);
// Those of one robot, newest first: what it has had since the server's start, then what the store
// has besides. At most `limit`, 0 = kReceiptsListed, and as many as fit.
inline constexpr size_t kReceiptsListed = 64;
void Encode(const std::vector<store::ReceiptRecord>& newest,
            const std::vector<store::ReceiptRecord>& stored, uint32_t limit,
            rips::v1::ListReceiptsResponse& out);
void Encode(const pipeline::DrillEntry& drill, rips::v1::ActuatorDrill* out);

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECEIPT_CODEC_H_
