// What actuators answered, as operators get it.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECEIPT_CODEC_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECEIPT_CODEC_H_

#include "policy_server/server/robot/actuators/drill_run.h"
#include "policy_server/server/robot/actuators/receipt_history.h"
#include "rips/v1/operator.pb.h"

namespace rips::operator_api {

// Texts must be UTF-8, as receipt_history.h makes them.
void Encode(const pipeline::LoggedReceipt& receipt, rips::v1::ReceivedReceipt* out);
void Encode(const pipeline::DrillEntry& drill, rips::v1::ActuatorDrill* out);

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_RECEIPT_CODEC_H_
