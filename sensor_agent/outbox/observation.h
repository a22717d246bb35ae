// What this sensor saw, before it is put on the wire: services/model/observation.h, and the kinds
// that name a writer. Here a shared source stands where the wire has interned ids.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_OBSERVATION_H_
#define RIPS_SENSOR_AGENT_OUTBOX_OBSERVATION_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "services/model/observation.h"
#include "services/ros2/ros_graph.h"

namespace rips::sensor {

using model::Finding;
using model::GraphChange;
using model::IdsAlert;
using model::SensorState;
using model::SignalSeen;

// Each lane has its own sequence and acknowledgement.
enum class Lane { kControl, kMessages };

// One writer on one topic. Immutable and shared by all its messages; when the writer's node
// becomes known a new one takes its place.
struct MessageSource {
  std::string topic;  // ROS names
  std::string type;
  ros2::Endpoint writer;
};

// The first bytes of a serialized payload, CDR header included. Null = none are held.
using Payload = std::shared_ptr<const std::string>;
// Estimated memory of a payload beyond its bytes.
inline constexpr size_t kPayloadOverheadBytes = 96;

struct MessageSeen {
  int64_t boottime_ns = 0;  // reception
  std::shared_ptr<const MessageSource> source;
  uint64_t writer_sequence = 0;  // 0 = not known
  int64_t source_unix_ns = 0;
  uint32_t size_bytes = 0;  // whole payload with its CDR header
  Payload payload;
  // It was sent with its payload, which is no longer held (Outbox::DropSentPayloads).
  bool payload_dropped = false;
  // Version of the graph, within this incarnation, in which the writer stands as `source` says: the
  // one in force when the message was taken, or the next one. 0 = not named.
  uint64_t graph_version = 0;
  // First of its source: does not wait for a batch to fill.
  bool urgent = false;
};

enum class LossCause { kDdsGap, kQueueFull, kOutboxShed, kSpoolLost, kLimit, kUndecodable };

struct Loss {
  LossCause cause = LossCause::kLimit;
  std::string topic;                            // ROS name; empty = several or none
  std::shared_ptr<const MessageSource> source;  // null = several or not known
  uint64_t count = 0;
  int64_t first_boottime_ns = 0;
  int64_t last_boottime_ns = 0;
};

struct ControlObservation {
  int64_t boottime_ns = 0;
  model::ObservationOf<Loss> what;
};

// See model::SensorState.
struct FindingsTold {
  uint64_t digest = 0;
  bool all = false;

  friend bool operator==(const FindingsTold&, const FindingsTold&) = default;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_OBSERVATION_H_
