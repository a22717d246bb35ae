// Trace: why a rule fired, as it is recorded with what came of it. Owns all it says, so that it can
// be read when rules, graph and robot have long changed. RIPS's own alert of a finding has one with
// nothing but the finding and its subjects.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TRACE_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TRACE_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "services/model/observation.h"
#include "services/ros2/guid.h"

namespace rips::engine {

// An expression within the rule's condition, and what it was.
struct TracedValue {
  // Where it stands in Trace::condition, in bytes.
  uint32_t offset = 0;
  uint32_t length = 0;
  // How many traced values it stands within.
  uint32_t depth = 0;
  // `true`, `7`, `"/cmd_vel"`, `not evaluated`, `false: there are 3`; at most kTracedTextBytesMax.
  std::string value;

  friend bool operator==(const TracedValue&, const TracedValue&) = default;
};

// Who or what made a condition true.
struct TracedSubject {
  // Of a node, topic or service, or an address; hostile text.
  std::string name;
  // `sent the message`, `publishes /cmd_vel`, `is not there`
  std::string role;
  // Of its endpoint or participant; none if it is not known.
  ros2::Guid guid;
  // As its process says; empty and 0 if it is not known.
  std::string host;
  uint32_t pid = 0;
  // IP address where it says that it is reached.
  std::string address;

  friend bool operator==(const TracedSubject&, const TracedSubject&) = default;
};

struct Trace {
  // `warehouse.rul:31`; empty = no rule fired.
  std::string place;
  // As it stands in the file; at most kConditionBytesMax.
  std::string condition;
  // Outer before inner, left before right; at most kTracedValuesMax.
  std::vector<TracedValue> values;
  // At most kSubjectsMax.
  std::vector<TracedSubject> subjects;
  // What was judged, for people, and when it happened by the clock of the robot's host.
  std::string event;
  int64_t event_unix_ns = 0;
  // Id of the bundle that held the rule.
  std::string bundle;
  // There were more values or subjects, or the condition is longer.
  bool cut = false;
  // What was judged, if it was a finding, without its detail; without a kind: it was not. `over`:
  // the alert records its end.
  model::Finding finding;

  // No rule fired.
  bool none() const { return place.empty(); }
  bool has_finding() const { return !finding.kind.empty(); }
  friend bool operator==(const Trace&, const Trace&) = default;
};

// Null = there is none.
using SharedTrace = std::shared_ptr<const Trace>;
inline Trace CopyOf(const SharedTrace& trace) { return trace == nullptr ? Trace{} : *trace; }

inline constexpr size_t kTracedValuesMax = 32;
inline constexpr size_t kSubjectsMax = 16;
inline constexpr size_t kTracedTextBytesMax = 128;
inline constexpr size_t kConditionBytesMax = 1'024;

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TRACE_H_
