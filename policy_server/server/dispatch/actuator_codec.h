// Commands to the wire, hellos, receipts and heartbeats from it.
#ifndef RIPS_POLICY_SERVER_SERVER_DISPATCH_ACTUATOR_CODEC_H_
#define RIPS_POLICY_SERVER_SERVER_DISPATCH_ACTUATOR_CODEC_H_

#include "absl/status/statusor.h"
#include "policy_server/server/robot/links.h"
#include "policy_server/server/robot/model/actuator_inbound.h"
#include "rips/v1/actuator.pb.h"
#include "rips/v1/command.pb.h"

namespace rips::dispatch {

// Of messages within their limits (wire_limits::Check). FailedPrecondition for a newer protocol;
// InvalidArgument for a GUID of a wrong length, a part that is no node name, or an unknown stage.
absl::StatusOr<pipeline::ActuatorHello> DecodeHello(const rips::v1::ActuatorHello& hello);
absl::StatusOr<pipeline::Receipt> DecodeReceipt(const rips::v1::Receipt& receipt);
pipeline::ActuatorHeartbeat DecodeHeartbeat(const rips::v1::ActuatorHeartbeat& heartbeat);

rips::v1::Command EncodeCommand(const pipeline::Command& command);
// `now` of the server goes into the heartbeat.
rips::v1::Lease EncodeLease(const pipeline::LeaseGrant& lease, Instant now);

}  // namespace rips::dispatch

#endif  // RIPS_POLICY_SERVER_SERVER_DISPATCH_ACTUATOR_CODEC_H_
