// What sensors say, decoded and free of protobuf. Actuators: actuator_inbound.h.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_INBOUND_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_INBOUND_H_

#include <cstdint>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/state/event.h"
#include "policy_server/server/store/generations.h"
#include "services/base/clock.h"
#include "services/base/decision_id.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::pipeline {

enum class Lane { kControl, kMessages };
inline constexpr int kLaneCount = 2;

struct MessageSeen {
  // Views into Batch::names.
  absl::string_view topic;
  // Beside that name; may be null.
  engine::TopicMemo* memo = nullptr;
  absl::string_view type;
  // Node the sensor named when it introduced the writer; the server's graph knows better.
  absl::string_view sender;
  ros2::Guid writer;
  // Of the serialized payload on the robot.
  uint32_t size_bytes = 0;
  // Its first bytes, if the sensor was asked for them; at most kPayloadBytesHard.
  std::string payload;
  // `payload` is shorter than size_bytes.
  bool truncated = false;
  // Of the sensor's graph, that shows the writer; 0 = not named.
  uint64_t graph_version = 0;
};

struct GraphSnapshotSeen {
  uint64_t version = 0;
  bool settled = false;
  // Only upserts.
  ros2::GraphDelta content;
};

struct GraphDeltaSeen {
  uint64_t from_version = 0;
  uint64_t to_version = 0;
  bool settled = false;
  ros2::GraphDelta delta;
};

struct IdsAlertSeen {
  std::string message;
  uint32_t gid = 0;
  uint32_t sid = 0;
  // The whole line of an IDS that writes lines of free text; else empty.
  std::string line;
  // Addresses; may be empty.
  std::string source;
  std::string target;
};

struct SignalSeen {
  std::string name;
};

struct LossSeen {
  uint64_t count = 0;
  // A gap of a best-effort writer: normal on a busy bus, does not spoil evidence.
  bool tolerable = false;
  // For people: "outbox shed", "queue full".
  std::string cause;
  // Empty = several or not known.
  std::string topic;
  std::string type;
  // none() = several or not known.
  ros2::Guid writer;
  // When the first and the last were due, CLOCK_BOOTTIME of the sensor's host; 0 = not known.
  int64_t first_boottime_ns = 0;
  int64_t last_boottime_ns = 0;
};

struct SensorStateSeen {
  bool overloaded = false;
  uint64_t outbox_bytes = 0;
  int64_t oldest_unacked_ns = 0;
  uint64_t spool_bytes = 0;
  // Kinds of traffic the sensor cannot see, for people; hostile text.
  std::vector<std::string> not_visible;
  // Inputs that it was told to watch and cannot, with the reason; hostile text.
  std::vector<std::string> blind;
};

struct FindingSeen {
  // As rules name it.
  std::string kind;
  // Participant or endpoint it is about; none() = none in particular.
  ros2::Guid guid;
  std::string node;
  std::string topic;
  // For people; hostile text.
  std::string detail;
  // Told before, and no longer so.
  bool over = false;
};

struct Observation {
  // CLOCK_BOOTTIME of the sensor's host.
  int64_t boottime_ns = 0;
  std::variant<MessageSeen, GraphSnapshotSeen, GraphDeltaSeen, IdsAlertSeen, SignalSeen, LossSeen,
               SensorStateSeen, FindingSeen>
      what;
};

inline bool IsGraph(const Observation& seen) {
  return std::holds_alternative<GraphSnapshotSeen>(seen.what) ||
         std::holds_alternative<GraphDeltaSeen>(seen.what);
}

struct Batch {
  std::string incarnation;
  Lane lane = Lane::kMessages;
  // Of observations[0]; the rest follow without gap.
  uint64_t first_sequence = 0;
  std::vector<Observation> observations;
  // As counted against credit: serialized size on the wire.
  size_t bytes = 0;
  // As counted against the credit of payloads: what came in chunks before this batch.
  size_t payload_bytes = 0;
  // Keeps the strings alive that the views point to.
  std::shared_ptr<const void> names;
};

struct SpooledRange {
  std::string incarnation;
  Lane lane = Lane::kControl;
  uint64_t first_sequence = 0;
  uint64_t last_sequence = 0;
  // The highest number that the sensor was told is durable; 0 = none, or it does not say.
  uint64_t acknowledged = 0;
};

struct SensorHello {
  std::string incarnation;
  Instant clock;
  std::vector<SpooledRange> spooled;
  // DDS domain it watches.
  uint32_t domain = 0;
  // Both as in SensorStateSeen.
  std::vector<std::string> not_visible;
  std::vector<std::string> blind;
  // Id of the interest it watches by; empty = none.
  std::string interest_in_use;
  // What the store held by the last that it was told, of this process or one before.
  store::StorePoint store;
  // Its address, as the transport says.
  std::string peer;
  // On the robot's bus; none() = it does not say.
  ros2::Guid participant;
};

struct SensorHeartbeat {
  // The sensor's own clocks when it sent this.
  Instant clock;
  // The newest boottime of the server that the sensor had seen by then; 0 = none.
  int64_t echo_boottime_ns = 0;
};

// The sensor's answer to an interest.
struct InterestAnswer {
  std::string id;
  // Why not, for people; hostile text. Empty = in use.
  std::string problem;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_INBOUND_H_
