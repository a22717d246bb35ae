// Commands, leases, receipts, hellos and heartbeats between services/model and rips.v1: both ends
// of the actuator's stream and the operator API share it.
#ifndef RIPS_SERVICES_MODEL_PROTO_ACTUATOR_CODEC_H_
#define RIPS_SERVICES_MODEL_PROTO_ACTUATOR_CODEC_H_

#include <cstdint>

#include "absl/status/statusor.h"
#include "google/protobuf/repeated_ptr_field.h"
#include "rips/v1/actuator.pb.h"
#include "rips/v1/command.pb.h"
#include "services/base/clock.h"
#include "services/model/command.h"
#include "services/model/receipt.h"

namespace rips::model_proto {

// Of the actuator's stream, in its hello.
inline constexpr uint32_t kActuatorProtocol = 1;

// ---- server to actuator

rips::v1::Command Encode(const model::Command& command);
// InvalidArgument, saying what is wrong: an id that is not 16 bytes, no kind, a program without a
// name, a drill without a level.
absl::StatusOr<model::Command> Decode(const rips::v1::Command& wire);

// `now` of the server goes into the heartbeat.
rips::v1::Lease Encode(const model::LeaseGrant& lease, Instant now);
model::LeaseGrant Decode(const rips::v1::Lease& wire);

// ---- actuator to server

rips::v1::Receipt Encode(const model::Receipt& receipt);
rips::v1::Receipt::Stage Encode(model::Receipt::Stage stage);
void Encode(const std::vector<model::StepResult>& steps,
            google::protobuf::RepeatedPtrField<rips::v1::StepResult>& wire);
// InvalidArgument: a stage that is unknown. How far a drill of a newer protocol went counts as not
// tried.
absl::StatusOr<model::Receipt> Decode(const rips::v1::Receipt& wire);

// All but version, incarnation and host.
rips::v1::ActuatorHello Encode(const model::ActuatorHello& hello);
// Of a message within its limits (wire_limits::Check). FailedPrecondition: a newer protocol.
// InvalidArgument: no protocol, a GUID that is not 16 bytes, a part that is no node name, a head of
// an audit log that is not whole.
absl::StatusOr<model::ActuatorHello> Decode(const rips::v1::ActuatorHello& wire);

// All but the echo and the wall clock.
rips::v1::ActuatorHeartbeat Encode(const model::ActuatorHeartbeat& heartbeat);
// Makes `degraded` printable, and cuts it to its limits.
model::ActuatorHeartbeat Decode(const rips::v1::ActuatorHeartbeat& wire);

}  // namespace rips::model_proto

#endif  // RIPS_SERVICES_MODEL_PROTO_ACTUATOR_CODEC_H_
