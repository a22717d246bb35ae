// Event: what a rule may look at.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_EVENT_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_EVENT_H_

#include <cstdint>
#include <string>
#include <variant>

#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "policy_server/policy/engine/state/verdict.h"
#include "policy_server/policy/levels/level_machine.h"
#include "services/ros2/guid.h"

namespace rips::engine {

// Where the engine keeps what it knows of a topic, beside the topic's name, so that it need not
// look the name up again. Belongs to whoever owns the name; the evaluator alone writes to it, on
// the robot's thread.
struct TopicMemo {
  const void* cache = nullptr;
  uint64_t epoch = 0;
  void* entry = nullptr;
  // Of the name of the type that came with the topic; it lives as long as the topic's.
  const char* type = nullptr;
};

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
  // Of the very string that `topic` views; may be null.
  TopicMemo* memo = nullptr;
  // By index of CheckedRules::inspections of the program in force, which NeededInspections asked
  // for. One that is not there was not told.
  absl::Span<const Verdict> inspections;
};

// The graph in RobotState has changed.
struct GraphEvent {};

// What `rules External` are run on.
//
// An alert of the host's intrusion detection system.
struct IdsEvent {
  std::string message;
  uint32_t gid = 0;
  uint32_t sid = 0;
  // The whole line, where the IDS writes lines of free text; else empty.
  std::string line;
  // Addresses; may be empty.
  std::string source;
  std::string target;
};
struct SignalEvent {
  // With `SIG`.
  std::string name;
};
struct AgentEvent {
  std::string agent;  // sensor | actuator
  std::string state;  // connected | lost | restarting | drift | failed | state_lost | ...
};
// Something that sensors look for whatever the rules say.
struct FindingEvent {
  // duplicate_node | impostor | ...
  std::string kind;
  // What it is about, as far as it is about such; `detail` is for people.
  ros2::Guid guid;
  std::string node;
  std::string topic;
  std::string detail;
};
// Observations that were not taken or not kept. What is lost of a topic counts in its windows, and
// what is lost of nobody knows which topic, in all windows.
struct LossEvent {
  // More than this of one event count as this many.
  static constexpr uint64_t kCountedMax = uint64_t{1} << 32;

  uint64_t count = 0;
  // Empty = several or not known.
  std::string topic;
  std::string type;
  // none() = several or not known.
  ros2::Guid writer;
  // When the first and the last of them were due, nanoseconds since the Unix epoch; 0 = now.
  int64_t first_unix_ns = 0;
  int64_t last_unix_ns = 0;
  // For people.
  std::string cause;
};
struct TickEvent {};
using ExternalEvent =
    std::variant<IdsEvent, SignalEvent, AgentEvent, FindingEvent, LossEvent, TickEvent>;

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

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_EVENT_H_
