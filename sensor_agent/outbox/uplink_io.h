// What happens to the uplink's core, and what it wants done: plain values.
//
// An action that says "result:" is performed at once, and its result is the next input.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_UPLINK_IO_H_
#define RIPS_SENSOR_AGENT_OUTBOX_UPLINK_IO_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "sensor_agent/outbox/backlog.h"
#include "sensor_agent/outbox/observation.h"
#include "sensor_agent/outbox/outbox.h"
#include "sensor_agent/outbox/spool_types.h"

namespace rips::sensor {

// --- Inputs: from the sensor

// What was seen since the last one, in order.
struct Observations {
  std::vector<GraphChange> graph;
  std::vector<MessageSeen> messages;
  std::vector<Loss> losses;
  std::vector<std::string> signals;
  // With the time they were seen.
  std::vector<ControlObservation> ids_alerts;
  std::vector<ControlObservation> findings;
  // As of these; none = as before.
  std::optional<FindingsTold> findings_told;
  // The settled snapshot is among `graph`: messages may follow.
  bool settled = false;
};

// The whole graph, as Outbox::ReplaceGraph takes it.
struct WholeGraph {
  std::vector<GraphChange> snapshot;
};
// Whether this kind of traffic is visible from now on.
struct KindVisible {
  std::string kind;
  bool visible = false;
};
// Why what `input` stands for is not seen; no reasons = it is. Human-readable.
struct Blindness {
  std::string input;
  std::vector<std::string> reasons;
};

// --- Inputs: from the server

// `incarnation`: 16 random bytes, used if a new one is needed.
struct StreamBegan {
  std::string incarnation;
};
struct StreamEnded {
  absl::Status status;
};
struct ConfigReceived {
  BatchPolicy policy;
  // See HeartbeatIntervalNs.
  uint32_t heartbeat_ms = 0;
  bool primary = true;
  bool want_snapshot = false;
  bool want_findings = false;
};
// Totals of the stream.
struct CreditReceived {
  uint64_t message_bytes = 0;
  uint64_t payload_bytes = 0;
};
struct AckReceived {
  StreamKey stream;
  uint64_t sequence = 0;
};
struct ServerHeartbeat {
  uint64_t boottime_ns = 0;
};

// --- Inputs: time, and results of actions

// The time has come that the last actions named, or there may be something to do.
struct Turn {};
// After AwaitLine: all chunks are written.
struct LineFree {};
// kLineFull: not encoded, to be tried again. kNamesUsedUp: the stream has no ids left. kMalformed:
// that batch cannot be decoded.
enum class SendStatus { kSent, kLineFull, kNamesUsedUp, kMalformed };
// `count` of the observations were sent, in a batch of `bytes`.
struct BatchSent {
  SendStatus status = SendStatus::kSent;
  size_t count = 0;
  uint64_t bytes = 0;
};
struct ChunkSent {
  bool sent = true;
};
struct ChunksTakenBack {
  uint64_t bytes = 0;
};
// The batch without the payload that must go in chunks, if there is one, takes at most `bytes_max`.
struct BacklogOpened {
  SendStatus status = SendStatus::kSent;
  Payload chunked;
  uint64_t bytes_max = 0;
};
struct BacklogSent {
  SendStatus status = SendStatus::kSent;
  size_t count = 0;
  uint64_t bytes = 0;
};
struct Encoded {
  StreamKey stream;
  uint64_t first_sequence = 1;
  uint32_t count = 0;
  int64_t oldest_ns = 0;
  std::string bytes;
};
// All unacknowledged observations go to disk.
struct Stopping {};

using UplinkInput =
    std::variant<Observations, WholeGraph, KindVisible, Blindness, StreamBegan, StreamEnded,
                 ConfigReceived, CreditReceived, AckReceived, ServerHeartbeat, Turn, LineFree,
                 BatchSent, ChunkSent, ChunksTakenBack, BacklogOpened, BacklogSent, Encoded,
                 Recovered, SpoolReleased, SpoolReadBack, SpoolWritten, Stopping>;

// --- Actions

struct AnnouncedRange {
  BacklogRange range;
  // The highest that a server has reported durable; nullopt = none.
  std::optional<uint64_t> acknowledged;
};
// The stream's first message.
struct SendHello {
  std::string incarnation;
  // A former stream was refused for what it said: its incarnation is given up.
  bool incarnation_is_new = false;
  std::vector<AnnouncedRange> ranges;
  std::vector<std::string> not_visible;
  std::vector<std::string> blind;
};
struct SendHeartbeat {
  uint64_t echo_boottime_ns = 0;
};
// The first `count` unsent observations of the lane. chunked_id: the number under which the payload
// of the last one went in chunks; 0 = none did. Result: BatchSent.
struct SendBatch {
  Lane lane = Lane::kMessages;
  size_t count = 0;
  uint64_t chunked_id = 0;
};
// Result: ChunkSent; not sent if the line holds too many chunks: then as AwaitLine.
struct SendChunk {
  Payload payload;
  uint64_t id = 0;
  size_t offset = 0;
  size_t bytes = 0;
};
// Chunks of which nothing is written are dropped. Result: ChunksTakenBack.
struct TakeChunksBack {};
// Input LineFree follows, at once or when all chunks are written.
struct AwaitLine {};
// Decodes the batch and keeps it for SendBacklog. Result: BacklogOpened.
struct OpenBacklog {
  BacklogBatch batch;
};
// The batch opened last. Its long payload went in chunks as `chunked_id`, or (0) is left out.
// Result: BacklogSent.
struct SendBacklog {
  uint64_t chunked_id = 0;
};
// Result: Encoded.
struct EncodeForBacklog {
  StreamKey stream;
  uint64_t first_sequence = 1;
  std::variant<std::vector<MessageSeen>, std::vector<ControlObservation>> observations;
  // Of messages: as GraphTrail::Bring gives it.
  std::vector<GraphChange> graph = {};
};
// What the server needs to go on was said: batches flow.
struct StreamResumed {};
// Ends this stream and begins another; the core takes it for ended.
struct CloseStream {
  std::string why;
};
// WholeGraph should come soon: nothing is sent until then.
struct WantGraph {};
// The server has forgotten what it acknowledged, or asks for it: what stands should be appended
// again, but for the graph.
struct ServerForgot {};
// These observations of the backlog are lost.
struct BacklogLost {
  uint64_t first_sequence = 1;
  absl::Status why;
};

using UplinkAction =
    std::variant<SendHello, SendHeartbeat, SendBatch, SendChunk, TakeChunksBack, AwaitLine,
                 OpenBacklog, SendBacklog, EncodeForBacklog, StreamResumed, CloseStream, WantGraph,
                 ServerForgot, BacklogLost, SpoolWrite, SpoolRead, SpoolRelease>;

struct UplinkActions {
  // In order.
  std::vector<UplinkAction> list;
  // Turn should come then, CLOCK_BOOTTIME; a time that has passed = at once.
  int64_t wake_ns = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_UPLINK_IO_H_
