// Wire batches to what the pipeline judges. One per sensor stream: interned names live here.
#ifndef RIPS_POLICY_SERVER_SERVER_INGEST_OBSERVATION_DECODER_H_
#define RIPS_POLICY_SERVER_SERVER_INGEST_OBSERVATION_DECODER_H_

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/server/ingest/chunk_assembler.h"
#include "policy_server/server/robot/model/inbound.h"
#include "rips/v1/observation.pb.h"
#include "rips/v1/sensor.pb.h"
#include "services/model/observation.h"

namespace rips::ingest {

// What no field alone can exceed; each field's own limit is wire_limits::Check's business.
struct DecodeLimits {
  // Of one batch.
  size_t inline_payload_bytes = 1 << 20;
  // Interned topics, types and writers of one stream, and their highest id.
  size_t interned = 65'536;
};

// All that is decoded here is within the limits of its fields (wire_limits::Check).
//
// InvalidArgument: the hello is malformed (protocol, length of incarnation or generation, a range
// that starts at 0). FailedPrecondition: a protocol number above ours.
absl::StatusOr<pipeline::SensorHello> DecodeHello(const rips::v1::SensorHello& hello);

// Times that no clock shows become 0.
pipeline::SensorHeartbeat DecodeHeartbeat(const rips::v1::Heartbeat& heartbeat);

// Not thread-safe; one call at a time.
class ObservationDecoder {
 public:
  explicit ObservationDecoder(DecodeLimits limits = {});

  // InvalidArgument: unknown lane, ids never interned or interned twice, wrong lengths, one lane's
  // kind in the other lane, a payload longer than its message. ResourceExhausted: past a limit. An
  // observation of a kind this version does not know becomes a loss of one. After a refusal the
  // stream must be closed.
  absl::StatusOr<pipeline::Batch> Decode(const rips::v1::ObservationBatch& batch);
  // Takes the contents of `chunk`, of a payload that the next batch of the message lane may name.
  // Errors as ChunkAssembler; the stream must then be closed, too.
  absl::Status TakeChunk(rips::v1::PayloadChunk& chunk) { return payloads_.Add(chunk); }

 private:
  struct Name {
    enum class Kind { kTopic, kType, kWriter };
    Kind kind = Kind::kTopic;
    // Of a writer: its node's name.
    std::string text;
    // Of a topic. Touched by whoever judges, never here.
    mutable engine::TopicMemo memo;
    // Of a writer. Its topic and type are empty if they are not of ROS.
    ros2::Guid guid;
    std::string writes_topic;
    std::string writes_type;
    bool reliable = false;
  };
  // By id; null where none was interned. Shared with batches under judgement, so names stay where
  // they are.
  using Names = std::vector<std::unique_ptr<const Name>>;

  absl::Status TakeNames(const rips::v1::ObservationBatch& batch);
  absl::StatusOr<std::unique_ptr<const Name>> TakeName(const rips::v1::Intern& intern) const;
  // Null if `id` is none of a name of that kind.
  const Name* Find(uint32_t id, Name::Kind kind) const {
    const Name* name = id < names_->size() ? (*names_)[id].get() : nullptr;
    return name != nullptr && name->kind == kind ? name : nullptr;
  }
  // Into `one` and `seen`, which are empty.
  absl::Status DecodeOne(const rips::v1::Observation& observation, pipeline::Lane lane,
                         pipeline::Observation& one);
  absl::Status DecodeMessage(const rips::v1::MessageSeen& message, pipeline::MessageSeen& seen);
  absl::StatusOr<model::Loss> DecodeLoss(const rips::v1::Loss& loss) const;

  DecodeLimits limits_;
  ChunkAssembler payloads_;
  std::shared_ptr<Names> names_;
};

}  // namespace rips::ingest

#endif  // RIPS_POLICY_SERVER_SERVER_INGEST_OBSERVATION_DECODER_H_
