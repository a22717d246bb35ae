// What this sensor saw, before it is put on the wire: plain values without protobuf. rips.v1
// (observation.proto) says what each means; here strings stand where the wire has interned ids.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_OBSERVATION_H_
#define RIPS_SENSOR_AGENT_OUTBOX_OBSERVATION_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "services/ros2/ros_graph.h"

namespace rips::sensor {

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

// A step of the graph. from_version 0 = a snapshot: `delta` holds everything and applies to the
// empty graph.
struct GraphChange {
  uint64_t from_version = 0;
  uint64_t to_version = 0;
  // Rules may judge "exactly these" after this step.
  bool settled = false;
  ros2::GraphDelta delta;
};

struct SignalSeen {
  std::string name;  // SIGUSR1, SIGUSR2
  uint32_t count = 0;
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

struct SensorState {
  bool overloaded = false;
  uint64_t outbox_bytes = 0;
  int64_t oldest_unacked_ns = 0;  // age
  uint64_t spool_bytes = 0;       // on disk
  // Kinds of traffic that cannot be seen now.
  std::vector<std::string> not_visible;
  // Inputs that are configured and cannot be seen now, with the reason.
  std::vector<std::string> blind;

  friend bool operator==(const SensorState&, const SensorState&) = default;
};

// An alert of the host's intrusion detection system.
struct IdsAlert {
  std::string source;  // snort, suricata
  uint32_t gid = 0;
  uint32_t sid = 0;
  uint32_t rev = 0;
  std::string message;
  uint32_t severity = 0;  // 1 = most severe
  std::string src;        // addresses; may be empty
  std::string dst;
  std::string line;  // of an IDS that writes lines of free text; else empty

  friend bool operator==(const IdsAlert&, const IdsAlert&) = default;
};

// Something looked for whatever the rules say, when it begins and when it is over.
struct Finding {
  std::string kind;  // as rules name it
  // Participant or endpoint it is about; none() = none in particular.
  ros2::Guid guid;
  std::string node;  // may be empty
  std::string topic;
  std::string detail;  // for people
  bool over = false;

  friend bool operator==(const Finding&, const Finding&) = default;
};

struct ControlObservation {
  int64_t boottime_ns = 0;
  std::variant<GraphChange, SignalSeen, Loss, SensorState, IdsAlert, Finding> what;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_OBSERVATION_H_
