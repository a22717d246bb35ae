// Event: what a rule may look at.
#ifndef RIPS_POLICY_SERVER_ENGINE_EVENT_H_
#define RIPS_POLICY_SERVER_ENGINE_EVENT_H_

#include <cstdint>
#include <string>
#include <variant>

#include "absl/strings/string_view.h"
#include "policy_server/levels/level_machine.h"
#include "services/ros2/guid.h"

namespace rips::engine {

// A message on a topic. Views are borrowed for the call.
struct MessageEvent {
  // ROS names.
  absl::string_view topic;
  absl::string_view type;
  ros2::Guid writer;
  // Full name of the writing node; empty if it is not attributed.
  absl::string_view sender;
  // Serialized payload with its 4-byte CDR header.
  uint32_t size_bytes = 0;
};

// The graph in RobotState has changed.
struct GraphEvent {};

// What `rules External` are run on. Builtins that look into these come with a later version;
// rules over Time, levels and variables run on all of them.
struct IdsEvent {
  std::string message;
  uint32_t gid = 0;
  uint32_t sid = 0;
};
struct SignalEvent {
  std::string name;
};
struct AgentEvent {
  std::string agent;  // sensor | actuator
  std::string state;  // connected | lost | restarting | drift | failed | state_lost | ...
};
struct LossEvent {
  uint64_t count = 0;
};
struct TickEvent {};
using ExternalEvent = std::variant<IdsEvent, SignalEvent, AgentEvent, LossEvent, TickEvent>;

struct Event {
  std::variant<MessageEvent, GraphEvent, ExternalEvent> what;
  // `Time`: the sensor's reception time, nanoseconds since the Unix epoch. RobotState sees to it
  // that `Time` never goes back.
  int64_t time_unix_ns = 0;
  // Older than 5 s when judged: exec fails, a lowering is refused.
  levels::Lateness lateness = levels::Lateness::kTimely;
};

// For people: "message on /cmd_vel from /intruder", "graph change", "tick".
std::string Describe(const Event& event);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_ENGINE_EVENT_H_
