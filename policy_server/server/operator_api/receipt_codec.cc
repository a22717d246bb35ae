#include "policy_server/server/operator_api/receipt_codec.h"

#include "services/model_proto/actuator_codec.h"

namespace rips::operator_api {

void Encode(const pipeline::LoggedReceipt& receipt, rips::v1::ReceivedReceipt* out) {
  out->set_unix_ns(receipt.unix_ns);
  out->set_host(receipt.host);
  out->set_command(receipt.command);
  *out->mutable_receipt() = model_proto::Encode(receipt.receipt);
}

void Encode(const pipeline::DrillEntry& drill, rips::v1::ActuatorDrill* out) {
  out->set_level(drill.level);
  out->set_host(drill.host);
  if (drill.stage) out->set_stage(model_proto::Encode(*drill.stage));
  model_proto::Encode(drill.steps, *out->mutable_steps());
  out->set_detail(drill.detail);
}

}  // namespace rips::operator_api
