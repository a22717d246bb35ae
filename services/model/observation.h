// Observation: what a sensor saw, as plain values that own what they hold. Sensor, wire codec,
// server and recordings share these structs; rips.v1 (observation.proto) is their wire form.
//
// A message and, on the sensor, a loss are not here: their writers and topics have names that are
// interned for each stream, so that no message copies a name. The sensor holds shared sources
// (sensor_agent/outbox/observation.h), the server views into the names of a batch
// (policy_server/server/robot/model/inbound.h).
#ifndef RIPS_SERVICES_MODEL_OBSERVATION_H_
#define RIPS_SERVICES_MODEL_OBSERVATION_H_

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::model {

// A step of the graph. from_version 0 = a snapshot: `delta` holds everything, only upserts, and
// applies to the empty graph. Versions count from 1 within one incarnation of the sensor.
struct GraphChange {
  uint64_t from_version = 0;
  uint64_t to_version = 0;
  // Rules may judge "exactly these" after this step.
  bool settled = false;
  ros2::GraphDelta delta;

  bool whole() const { return from_version == 0; }
};

struct SignalSeen {
  // SIGUSR1, SIGUSR2
  std::string name;
  // Since the report before.
  uint32_t count = 1;

  friend bool operator==(const SignalSeen&, const SignalSeen&) = default;
};

// What the sensor says of itself.
struct SensorState {
  bool overloaded = false;
  // In memory.
  uint64_t outbox_bytes = 0;
  // Age.
  int64_t oldest_unacked_ns = 0;
  // On disk.
  uint64_t spool_bytes = 0;
  // Kinds of traffic that the sensor cannot see now. On the server untrusted text.
  std::vector<std::string> not_visible;
  // Inputs that are configured and cannot be seen now, with the reason. On the server untrusted.
  std::vector<std::string> blind;
  // The sum of DigestOf (finding_digest.h) of the findings that it has told and that stand, before
  // this; none = of a version that does not say. And whether no others may stand.
  std::optional<uint64_t> findings_digest = {};
  bool findings_all_told = false;

  friend bool operator==(const SensorState&, const SensorState&) = default;
};

// An alert of the host's intrusion detection system.
struct IdsAlert {
  // snort, suricata
  std::string source;
  uint32_t gid = 0;
  uint32_t sid = 0;
  uint32_t rev = 0;
  std::string message;
  // 1 = most severe.
  uint32_t severity = 0;
  // Addresses; on the server without the port. May be empty.
  std::string src;
  std::string dst;
  // The whole line of an IDS that writes lines of free text; else empty.
  std::string line;

  friend bool operator==(const IdsAlert&, const IdsAlert&) = default;
};

// Something that sensors look for whatever the rules say, when it begins and when it is over.
struct Finding {
  // As rules name it: duplicate_node, impostor, ...
  std::string kind;
  // Participant or endpoint it is about; none() = none in particular.
  ros2::Guid guid;
  // May be empty.
  std::string node;
  std::string topic;
  // Human-readable. On the server untrusted text.
  std::string detail;
  // Reported before, and no longer so.
  bool over = false;

  friend bool operator==(const Finding&, const Finding&) = default;
};

// Observations that were not taken or not kept, with every name resolved.
struct Loss {
  uint64_t count = 0;
  // Empty = several or not known.
  std::string topic;
  std::string type;
  // none() = several or not known.
  ros2::Guid writer;
  // When the first and the last were due, nanoseconds: in an observation CLOCK_BOOTTIME of the
  // sensor's host, in an event since the Unix epoch. 0 = not known.
  int64_t first_ns = 0;
  int64_t last_ns = 0;
  // Human-readable: "outbox shed", "queue full".
  std::string cause;
  // A gap of a best-effort writer: normal on a busy bus, does not spoil evidence.
  bool tolerable = false;

  friend bool operator==(const Loss&, const Loss&) = default;
};

// Every kind of observation, for a side that represents messages and losses in its own way.
template <typename LossType, typename... More>
using ObservationOf =
    std::variant<More..., GraphChange, SignalSeen, LossType, SensorState, IdsAlert, Finding>;

}  // namespace rips::model

#endif  // RIPS_SERVICES_MODEL_OBSERVATION_H_
