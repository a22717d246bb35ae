// One event of a recording, free of the file it came from.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_RECORDED_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_RECORDED_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/container/btree_map.h"
#include "policy_server/policy/engine/state/standing_findings.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "services/model/event.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::recording {

struct RecordedMessage {
  // ROS names: "/chatter", "std_msgs/msg/String". The type is empty if the recording has none.
  std::string topic;
  std::string type;
  // Full name of the node that wrote it; empty = not known.
  std::string sender;
  // All zero = not known.
  ros2::Guid writer;
  // Serialized payload as received, 4-byte CDR header included: its first bytes.
  std::string payload;
  // Of the whole serialized payload, bytes; 0 if `truncated` and not known.
  uint32_t size_bytes = 0;
  // `payload` is not all of it.
  bool truncated = false;

  friend bool operator==(const RecordedMessage&, const RecordedMessage&) = default;
};

struct RecordedGraph {
  // If `whole`, only upserts: the graph is these and nothing else. Otherwise a change of the graph
  // so far, which may be empty.
  ros2::GraphDelta content;
  bool whole = false;
  // "Exactly these" may be judged.
  bool settled = false;
};

// The level changed, and no rule did it. No rule is judged.
struct RecordedLevel {
  // Name of the level.
  std::string to;
  // `operator alice`, `adopted`
  std::string cause;

  friend bool operator==(const RecordedLevel&, const RecordedLevel&) = default;
};

// Not judged; it keeps its index.
struct RecordedOther {
  // The recording's word for it.
  std::string what;

  friend bool operator==(const RecordedOther&, const RecordedOther&) = default;
};

struct Recorded {
  // 0-based, without gaps, in the order the reader gives.
  uint64_t index = 0;
  // Nanoseconds since the Unix epoch; none if the recording has no times. May repeat or go back
  // where the reader's header says so.
  std::optional<int64_t> time_unix_ns;
  // Replaces the graph before this event is judged; always `whole`. Not an event of its own.
  std::optional<RecordedGraph> context;
  std::variant<RecordedMessage, RecordedGraph, model::ExternalEvent, RecordedLevel, RecordedOther>
      what;
  // RIPS saw less than all of the robot: no rule may lower the level. None = not known.
  std::optional<bool> blind;
  // Of which kinds findings stand. None = as at the event before; not known at the first one.
  std::optional<engine::StandingFindings> findings = {};
  // Judged so late that it may not lower the level, nor run programs.
  bool late = false;
  // What the recording lacks just before this event, and why; empty = nothing, as far as is known.
  std::string missing_before = {};
};

// An alert that a recording was saved with.
struct RecordedAlert {
  // Bytes of `text`.
  static constexpr size_t kTextBytesMax = 200;

  std::string id;
  // `(rips)` for RIPS's own.
  std::string rule;
  std::string severity;
  // As Shortened.
  std::string text;
  int64_t time_unix_ns = 0;

  friend bool operator==(const RecordedAlert&, const RecordedAlert&) = default;
};

// Where a recording of ours comes from.
struct RecordedOrigin {
  std::string robot;
  // SHA-256 of the bundle in force, hexadecimal; empty = none.
  std::string bundle_id;
  // Level at the start; empty = not known.
  std::string level;
  int64_t start_unix_ns = 0;
  // Version of the program that recorded, for people.
  std::string rips_version;
  // Those of the rules at the start; empty = not known.
  absl::btree_map<std::string, lang::Value> variables;
  // `Uptime` at the start; 0 = not known.
  int64_t uptime_ns = 0;
  // Those that it was saved with.
  std::vector<RecordedAlert> alerts;

  friend bool operator==(const RecordedOrigin&, const RecordedOrigin&) = default;
};

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_RECORDED_H_
