// From observations to rips.v1 batches of one stream. Names are sent once and then stand as
// numbers: from 1, never reused, valid for this stream only, so every stream has an encoder of its
// own. Texts and counts are cut to what the server takes (wire_limits).
#ifndef RIPS_SENSOR_AGENT_UPLINK_WIRE_ENCODER_H_
#define RIPS_SENSOR_AGENT_UPLINK_WIRE_ENCODER_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "rips/v1/observation.pb.h"
#include "sensor_agent/outbox/outbox.h"

namespace rips::sensor {

struct EncoderLimits {
  // What the server takes per stream is a little more; when it is reached a new stream is needed.
  size_t names = 60'000;
};

// Not thread-safe.
class WireEncoder {
 public:
  WireEncoder(std::string incarnation, EncoderLimits limits = {})
      : incarnation_(std::move(incarnation)), limits_(limits) {}

  // The first `count` unsent observations of `lane`; fewer if the stream runs out of numbers for
  // names. The payload of the last one went in chunks as `chunked_id`; 0 = all payloads are inline.
  // The batch is not marked sent.
  rips::v1::ObservationBatch Encode(const Outbox& outbox, Lane lane, size_t count,
                                    uint64_t chunked_id = 0);
  // All of `observations` (MessageSeen or ControlObservation), with every name they use: for the
  // backlog. Incarnation, lane and sequence are not set.
  template <typename Seen>
  static rips::v1::ObservationBatch EncodeAlone(const std::vector<Seen>& observations);
  // What such a batch of messages brings of the graph of its time.
  static void AddGraph(const std::vector<GraphChange>& steps, rips::v1::ObservationBatch& batch);
  // From names that stand in the batch alone to those of this stream; what is new to it is
  // introduced. Otherwise nothing has changed. ResourceExhausted: no numbers are left. DataLoss: an
  // id that nothing introduces.
  absl::Status Rename(rips::v1::ObservationBatch& batch);

  // Too few numbers are left for the names of one more observation; Encode gives nothing.
  bool full() const { return next_id_ + kNamesPerObservation > limits_.names + 1; }

 private:
  // Topic, type and writer.
  static constexpr size_t kNamesPerObservation = 3;

  struct SourceIds {
    uint32_t topic = 0;
    uint32_t type = 0;
    uint32_t writer = 0;
    // Keeps the address, which is the key, from being used for another.
    std::shared_ptr<const MessageSource> source;
  };

  // `chunked_id` 0 = the payload goes inline.
  void Add(const MessageSeen& message, rips::v1::ObservationBatch& batch, uint64_t chunked_id = 0);
  void Add(const ControlObservation& observation, rips::v1::ObservationBatch& batch);
  void AddLoss(const Loss& loss, rips::v1::Loss& wire, rips::v1::ObservationBatch& batch);
  const SourceIds& IdsOf(const std::shared_ptr<const MessageSource>& source,
                         rips::v1::ObservationBatch& batch);
  uint32_t TopicId(const std::string& topic, rips::v1::ObservationBatch& batch);
  uint32_t IdOf(const rips::v1::Intern& intern, rips::v1::ObservationBatch& batch);

  const std::string incarnation_;
  const EncoderLimits limits_;
  uint32_t next_id_ = 1;
  absl::flat_hash_map<std::string, uint32_t> topics_;
  absl::flat_hash_map<std::string, uint32_t> types_;
  absl::flat_hash_map<const MessageSource*, SourceIds> sources_;
  // Of renamed batches, by what they serialize to.
  absl::flat_hash_map<std::string, uint32_t> writers_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_WIRE_ENCODER_H_
