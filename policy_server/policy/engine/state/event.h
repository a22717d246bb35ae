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
#include "services/model/event.h"
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

using model::AgentEvent;
using model::ExternalEvent;
using model::TickEvent;

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
