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
#include "services/model/observation.h"
#include "services/ros2/guid.h"

namespace rips::pipeline {

using model::GraphChange;
using model::IdsAlert;
using model::SignalSeen;
using FindingSeen = model::Finding;
using LossSeen = model::Loss;
using SensorStateSeen = model::SensorState;

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

struct Observation {
  // CLOCK_BOOTTIME of the sensor's host.
  int64_t boottime_ns = 0;
  model::ObservationOf<model::Loss, MessageSeen> what;
};

inline bool IsGraph(const Observation& seen) {
  return std::holds_alternative<model::GraphChange>(seen.what);
}

struct Batch {
  std::string incarnation;
  Lane lane = Lane::kMessages;
  // Of observations[0]; the rest follow without gap.
  uint64_t first_sequence = 0;
  std::vector<Observation> observations;
  // Of a former incarnation: steps of its graph that precede these messages.
  std::vector<model::GraphChange> graph;
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
