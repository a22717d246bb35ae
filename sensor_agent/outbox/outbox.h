// What was seen and is not yet acknowledged. Nothing leaves it but by an acknowledgement or as a
// counted loss.
//
// A sequence number is given when an observation is sent for the first time and then stays: after
// a reconnect the same observation goes out under the same number. What is shed before it was
// sent never had one, so the sequence the server sees has no holes of our making, except when
// observations in flight must go.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_OUTBOX_H_
#define RIPS_SENSOR_AGENT_OUTBOX_OUTBOX_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "sensor_agent/outbox/graph_base.h"
#include "sensor_agent/outbox/graph_trail.h"
#include "sensor_agent/outbox/lane_queue.h"
#include "sensor_agent/outbox/merged_reports.h"
#include "sensor_agent/outbox/observation.h"

namespace rips::sensor {

struct OutboxLimits {
  // Beyond, first payloads and then messages are shed, the oldest first, down to 7/8 of it, so that
  // one run leaves one Loss record for each source and not one for each message.
  size_t message_bytes = size_t{64} << 20;
  // Beyond, the graph steps not yet sent are folded into one snapshot and counted as Loss.
  size_t control_bytes = size_t{64} << 20;
  // Losses of more sources than this, still unsent, become one record "several" for each cause.
  size_t loss_records = 1'024;
  int64_t merge_ns = 100'000'000;
};

// Sequence numbers [first, last] that were given and not acknowledged; empty if last < first.
struct SequenceRange {
  uint64_t first = 1;
  uint64_t last = 0;

  friend bool operator==(const SequenceRange&, const SequenceRange&) = default;
};

// Not thread-safe. Times are CLOCK_BOOTTIME in nanoseconds.
class Outbox {
 public:
  explicit Outbox(OutboxLimits limits = {})
      : limits_(limits), merged_(limits.loss_records, limits.merge_ns) {}

  // --- Filling
  void AddMessage(MessageSeen message);
  void AddGraph(GraphChange change, int64_t now_ns);
  // Merged (MergedReports) until they are sent, at most each merge_ns.
  void AddLoss(Loss loss) { merged_.Add(std::move(loss)); }
  void AddSignal(const std::string& name, int64_t now_ns) { merged_.AddSignal(name, now_ns); }
  void AddState(const SensorState& state, int64_t now_ns) { merged_.AddState(state, now_ns); }
  // An IdsAlert or a Finding; never shed.
  void AddControl(ControlObservation observation);
  // Until this is called messages wait: the settled snapshot must be judged before them.
  void ReleaseMessages() { messages_released_ = true; }
  bool messages_released() const { return messages_released_; }

  // --- Sending. The unsent observations of a lane are [0, unsent(lane)).
  // Moves merged losses, signals and state behind the other control observations, if merge_ns has
  // passed since it last did; call it before a control batch is formed.
  void FlushMerged(int64_t now_ns);
  size_t unsent(Lane lane) const;
  const MessageSeen& UnsentMessage(size_t index) const;
  const ControlObservation& UnsentControl(size_t index) const;
  // Sequence that UnsentX(0) has or will get.
  uint64_t NextSequence(Lane lane) const;
  // The first `count` unsent ones have gone out. count <= unsent(lane).
  void MarkSent(Lane lane, size_t count);
  // When the lane's next batch should leave, given when the last one did; nullopt = nothing to
  // send. At once (now_ns) if a batch is full, something urgent waits, what waits was sent on an
  // earlier stream, or the line has been idle for the linger. Payloads fill a batch, too.
  std::optional<int64_t> DueAt(Lane lane, const BatchPolicy& policy, int64_t last_batch_ns,
                               int64_t now_ns) const;

  // --- Setting aside
  // Reception time of the oldest message that has no number yet.
  std::optional<int64_t> OldestUnnumbered() const;
  // Removes and gives the oldest messages without number: as many as `policy` allows for a batch,
  // none received at `until_ns` or later, none of a later version of the graph than the first.
  std::vector<MessageSeen> PopOldest(const BatchPolicy& policy, int64_t until_ns);
  // The same of control observations other than graph steps, which stay.
  std::vector<ControlObservation> PopOldestControl(const BatchPolicy& policy);
  // Removes and gives the oldest unsent ones, numbered or not: as many as `policy` allows for a
  // batch, no message of a later version of the graph than the first. The next one has the next
  // number.
  std::vector<MessageSeen> DrainMessages(const BatchPolicy& policy);
  std::vector<ControlObservation> DrainControl(const BatchPolicy& policy);
  // The graph that a batch of these messages, just removed, brings with it, in a stream of which
  // `brought` tells.
  std::vector<GraphChange> GraphOf(const std::vector<MessageSeen>& messages,
                                   GraphTrail::Brought& brought);
  // Counts `message` as one whose payload was shed, and sheds it.
  void ShedPayload(MessageSeen& message);
  // The same for unsent messages received before `before_ns` with more than `bytes` of payload: the
  // line does not carry them in time.
  void ShedUnsentPayloads(int64_t before_ns, size_t bytes);
  // Lets go of payloads of more than `bytes` whose messages were sent on this stream and are not
  // acknowledged, the oldest first, until message_bytes() is at most `goal`. They count as shed if
  // their messages must be sent again.
  void DropSentPayloads(size_t goal, size_t bytes);
  // As ShedUnsentPayloads, of the message that holds this very payload, if there is one.
  void ShedUnsentPayload(const Payload& payload);
  size_t message_bytes() const { return messages_.bytes; }
  size_t control_bytes() const { return control_.bytes; }

  // --- Acknowledging and resuming
  // Forgets up to and including `sequence`. Repeated and older ones do nothing. InvalidArgument
  // if that was never sent.
  absl::Status Acknowledge(Lane lane, uint64_t sequence);
  // Highest acknowledged sequence (or shed in flight); 0 = none.
  uint64_t acknowledged(Lane lane) const;
  SequenceRange Unacked(Lane lane) const;
  // How many alerts of the IDS have left, by an acknowledgement or by PopOldestControl; they leave
  // in the order added.
  uint64_t acknowledged_ids_alerts() const { return acknowledged_ids_alerts_; }
  // A new stream: everything unacknowledged is unsent again, numbers stay.
  void Rewind();
  // A new incarnation: numbers start at 1 again, nothing counts as sent; asks for a snapshot.
  void Renumber();

  // The server cannot go on from its graph. Graph steps are to be replaced by ReplaceGraph.
  void WantSnapshot() { snapshot_wanted_ = true; }
  bool snapshot_wanted() const { return snapshot_wanted_; }
  // The oldest graph step held is a snapshot: a server without a graph can start from it.
  bool GraphStartsWithSnapshot() const;
  // Makes it so without leaving a step out: the oldest step becomes a snapshot of the graph after
  // it (the same observation in another form), or, if it has no number, a snapshot of the graph
  // before it goes ahead of it. False if that is not known: then a snapshot of now is needed.
  bool StartGraphWithSnapshot(int64_t now_ns);
  // Takes `snapshot` (its parts, in order; none before discovery has settled) in place of every
  // graph step held. A step that already has a number becomes a Loss of 1 under that number; the
  // snapshot goes before everything that has none.
  void ReplaceGraph(std::vector<GraphChange> snapshot, int64_t now_ns);

  // The process ends: graph steps that are not acknowledged are left to the next one, with a
  // snapshot as the first of them. Where that is not known, or one is wanted, they are dropped, and
  // counted as Loss.
  void CloseGraph(int64_t now_ns);

  // Whether this sensor reports graph and messages. While it does not, both are refused here; on
  // becoming so a snapshot is wanted.
  void SetPrimary(bool primary);

  // --- Looking
  size_t bytes() const { return messages_.bytes + control_.bytes; }
  const OutboxLimits& limits() const { return limits_; }
  uint64_t shed_messages() const { return shed_messages_; }
  // Payloads shed; their messages stayed, as metadata.
  uint64_t shed_payloads() const { return shed_payloads_; }
  // Reception time of the oldest unacknowledged observation.
  std::optional<int64_t> OldestUnacked() const;

 private:
  void CountIdsAlert(const ControlObservation& gone);
  void PushControl(ControlObservation observation);
  void Shed();
  void ShedPayloadAt(size_t index);
  // Those of the messages [begin, end), until `goal` is met.
  void ShedPayloads(size_t begin, size_t end, size_t goal);
  void CountShed(const MessageSeen& message);
  // Removes the graph steps without number; how many there were.
  size_t DropUnnumberedGraph();
  // All graph steps; those with a number become a Loss of 1 under it, the others one Loss.
  void DropGraph(int64_t now_ns);

  OutboxLimits limits_;
  LaneQueue<MessageSeen> messages_;
  LaneQueue<ControlObservation> control_;
  MergedReports merged_;
  GraphBase graph_base_;
  GraphTrail trail_;
  bool messages_released_ = false;
  bool snapshot_wanted_ = false;
  bool primary_ = true;
  uint64_t shed_messages_ = 0;
  uint64_t shed_payloads_ = 0;
  uint64_t acknowledged_ids_alerts_ = 0;
  // Of payloads whose message has no number yet.
  size_t fresh_payload_bytes_ = 0;
};

size_t PayloadBytes(const MessageSeen& message);
// Estimated memory of one held observation, bytes.
size_t CostOf(const MessageSeen& message);
size_t CostOf(const ControlObservation& observation);
// Estimated size of a graph change, in memory and on the wire alike.
size_t CostOf(const ros2::GraphDelta& delta);
size_t CostOf(const ros2::Endpoint& endpoint);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_OUTBOX_H_
