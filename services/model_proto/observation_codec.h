// Observations and external events between services/model and rips.v1: both ends of the sensor's
// stream, the spool and recordings share it.
//
// Messages and losses of a stream use its interned names: WireEncoder and ObservationDecoder know
// those. What a receiver refuses beyond malformed bytes is its own decision; what it may hold is
// limited by wire_limits.
#ifndef RIPS_SERVICES_MODEL_PROTO_OBSERVATION_CODEC_H_
#define RIPS_SERVICES_MODEL_PROTO_OBSERVATION_CODEC_H_

#include <optional>
#include <variant>

#include "absl/status/statusor.h"
#include "rips/v1/observation.pb.h"
#include "rips/v1/recording.pb.h"
#include "services/model/event.h"
#include "services/model/observation.h"

namespace rips::model_proto {

// Each sets the kind of the empty `wire`.
void Encode(const model::GraphChange& change, rips::v1::Observation& wire);
void Encode(const model::SignalSeen& signal, rips::v1::Observation& wire);
void Encode(const model::SensorState& state, rips::v1::Observation& wire);
void Encode(const model::IdsAlert& alert, rips::v1::Observation& wire);
void Encode(const model::Finding& finding, rips::v1::Observation& wire);

// Any kind but a message and a loss; monostate = a kind that this version does not know.
// InvalidArgument: a GUID that is not 16 bytes, a graph that DecodeGraph refuses, versions of a
// graph that do not count up from 1.
using Nameless = std::variant<std::monostate, model::GraphChange, model::SignalSeen,
                              model::SensorState, model::IdsAlert, model::Finding>;
absl::StatusOr<Nameless> Decode(const rips::v1::Observation& wire);

// False, and `wire` stays empty, for a tick: a replay has ticks of its own.
bool Encode(const model::ExternalEvent& event, rips::v1::RecordedEvent& wire);
// nullopt: `wire` is no external event. InvalidArgument: a GUID that is not 16 bytes.
absl::StatusOr<std::optional<model::ExternalEvent>> DecodeExternal(
    const rips::v1::RecordedEvent& wire);

}  // namespace rips::model_proto

#endif  // RIPS_SERVICES_MODEL_PROTO_OBSERVATION_CODEC_H_
