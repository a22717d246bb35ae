#include "sensor_agent/outbox/outbox.h"

#include <algorithm>
#include <limits>
#include <utility>
#include <variant>

#include "services/base/check.h"
#include "services/base/overloaded.h"

namespace rips::sensor {

namespace {

// Of a map or deque node and its allocation.
constexpr size_t kEntryOverheadBytes = 32;
// The numbers of an item and its tags.
constexpr size_t kItemOverheadBytes = 64;

// Of the graph; `messages` are all that are held.
uint64_t OldestVersion(const std::deque<MessageSeen>& messages) {
  return messages.empty() ? std::numeric_limits<uint64_t>::max() : messages.front().graph_version;
}

bool IsGraph(const ControlObservation& observation) {
  return std::holds_alternative<GraphChange>(observation.what);
}

}  // namespace

size_t PayloadBytes(const MessageSeen& message) {
  return message.payload == nullptr ? 0 : message.payload->size();
}

size_t CostOf(const MessageSeen& message) {
  const size_t bytes = sizeof(MessageSeen) + kEntryOverheadBytes / 2;
  if (message.payload == nullptr) return bytes;
  return bytes + message.payload->size() + kPayloadOverheadBytes;
}

size_t CostOf(const ros2::Endpoint& endpoint) {
  size_t bytes = kItemOverheadBytes + endpoint.name.size() + endpoint.type.size() +
                 endpoint.node.size() + endpoint.why.size();
  for (const std::string& partition : endpoint.qos.partitions) bytes += partition.size() + 4;
  return bytes;
}

size_t CostOf(const ros2::GraphDelta& delta) {
  size_t bytes = delta.gone_guids.size() * kItemOverheadBytes;
  for (const ros2::Participant& each : delta.upsert_participants) {
    bytes += kItemOverheadBytes + each.host.size() + each.enclave.size() + each.vendor.size();
  }
  for (const ros2::Node& each : delta.upsert_nodes) {
    bytes += kItemOverheadBytes + each.full_name.size();
  }
  for (const ros2::Endpoint& each : delta.upsert_endpoints) bytes += CostOf(each);
  for (const std::string& each : delta.gone_nodes) bytes += kItemOverheadBytes + each.size();
  return bytes;
}

size_t CostOf(const ControlObservation& observation) {
  const size_t held =
      std::visit(Overloaded{[](const GraphChange& change) { return CostOf(change.delta); },
                            [](const Loss& loss) { return loss.topic.size(); },
                            [](const IdsAlert& ids) {
                              return ids.source.size() + ids.message.size() + ids.src.size() +
                                     ids.dst.size() + ids.line.size();
                            },
                            [](const Finding& finding) {
                              return finding.kind.size() + finding.node.size() +
                                     finding.topic.size() + finding.detail.size();
                            },
                            // Few and short.
                            [](const SignalSeen&) { return size_t{0}; },
                            [](const SensorState&) { return size_t{0}; }},
                 observation.what);
  return sizeof(ControlObservation) + kEntryOverheadBytes + held;
}

// --- Filling

void Outbox::AddMessage(MessageSeen message) {
  if (!primary_) return;
  messages_.urgent |= message.urgent;
  messages_.bytes += CostOf(message);
  fresh_payload_bytes_ += PayloadBytes(message);
  messages_.entries.push_back(std::move(message));
  if (messages_.bytes > limits_.message_bytes) Shed();
}

void Outbox::PushControl(ControlObservation observation) {
  control_.bytes += CostOf(observation);
  control_.urgent = true;
  control_.entries.push_back(std::move(observation));
}

void Outbox::AddGraph(GraphChange change, int64_t now_ns) {
  if (!primary_) return;
  trail_.Add(change);
  // The batches that are set aside during an outage go on from the one before.
  trail_.Advance(std::min(OldestVersion(messages_.entries), trail_.brought()));
  PushControl({.boottime_ns = now_ns, .what = std::move(change)});
  if (control_.bytes <= limits_.control_bytes) return;
  const size_t folded = DropUnnumberedGraph();
  if (folded == 0) return;
  snapshot_wanted_ = true;
  AddLoss({.cause = LossCause::kLimit,
           .count = folded,
           .first_boottime_ns = now_ns,
           .last_boottime_ns = now_ns});
}

void Outbox::AddControl(ControlObservation observation) { PushControl(std::move(observation)); }

void Outbox::FlushMerged(int64_t now_ns) {
  for (ControlObservation& each : merged_.Flush(now_ns)) PushControl(std::move(each));
}

void Outbox::CountShed(const MessageSeen& message) {
  ++shed_messages_;
  AddLoss({.cause = LossCause::kOutboxShed,
           .topic = message.source->topic,
           .source = message.source,
           .count = 1,
           .first_boottime_ns = message.boottime_ns,
           .last_boottime_ns = message.boottime_ns});
}

void Outbox::ShedPayloads(size_t begin, size_t end, size_t goal) {
  for (size_t i = begin; i < end && messages_.bytes > goal; ++i) {
    ShedPayloadAt(i);
  }
}

void Outbox::ShedPayloadAt(size_t index) {
  MessageSeen& message = messages_.entries[index];
  messages_.bytes -= CostOf(message);
  if (index >= messages_.numbered) fresh_payload_bytes_ -= PayloadBytes(message);
  ShedPayload(message);
  messages_.bytes += CostOf(message);
}

void Outbox::Shed() {
  const size_t goal = limits_.message_bytes / 8 * 7;
  // Those not yet numbered first: what is in flight may be judged already.
  ShedPayloads(messages_.numbered, messages_.entries.size(), goal);
  ShedPayloads(0, messages_.numbered, goal);
  auto begin = messages_.entries.begin() + static_cast<ptrdiff_t>(messages_.numbered);
  auto end = begin;
  while (messages_.bytes > goal && end != messages_.entries.end()) {
    CountShed(*end);
    messages_.bytes -= CostOf(*end);  // payloads are gone by now
    ++end;
  }
  messages_.entries.erase(begin, end);
  while (messages_.bytes > goal && !messages_.entries.empty()) {
    // Its number does not come, which the server counts; a Loss would count it twice.
    ++shed_messages_;
    messages_.bytes -= CostOf(messages_.entries.front());
    messages_.entries.pop_front();
    ++messages_.first_sequence;
    --messages_.numbered;
    if (messages_.sent > 0) --messages_.sent;
  }
}

// --- Sending

size_t Outbox::unsent(Lane lane) const {
  return lane == Lane::kControl ? control_.unsent() : messages_.unsent();
}

const MessageSeen& Outbox::UnsentMessage(size_t index) const {
  RIPS_CHECK(index < unsent(Lane::kMessages), "no such message");
  return messages_.entries[messages_.sent + index];
}

const ControlObservation& Outbox::UnsentControl(size_t index) const {
  RIPS_CHECK(index < unsent(Lane::kControl), "no such control observation");
  return control_.entries[control_.sent + index];
}

uint64_t Outbox::NextSequence(Lane lane) const {
  return lane == Lane::kControl ? control_.first_sequence + control_.sent
                                : messages_.first_sequence + messages_.sent;
}

void Outbox::MarkSent(Lane lane, size_t count) {
  if (lane == Lane::kControl) {
    control_.MarkSent(count);
  } else {
    const size_t numbered = messages_.numbered;
    messages_.MarkSent(count);
    for (size_t i = numbered; i < messages_.numbered; ++i) {
      fresh_payload_bytes_ -= PayloadBytes(messages_.entries[i]);
    }
  }
}

std::optional<int64_t> Outbox::DueAt(Lane lane, const BatchPolicy& policy, int64_t last_batch_ns,
                                     int64_t now_ns) const {
  if (snapshot_wanted_) return std::nullopt;
  if (lane == Lane::kMessages) {
    if (!messages_released_) return std::nullopt;
    if (fresh_payload_bytes_ >= policy.bytes) return now_ns;
    return messages_.DueAt(policy, last_batch_ns, now_ns);
  }
  std::optional<int64_t> due = control_.DueAt(policy, last_batch_ns, now_ns);
  if (!merged_.empty()) {
    const int64_t merged_ns = merged_.DueAt(now_ns);
    due = std::min(due.value_or(merged_ns), merged_ns);
  }
  return due;
}

// --- Setting aside

std::optional<int64_t> Outbox::OldestUnnumbered() const {
  if (messages_.numbered == messages_.entries.size()) return std::nullopt;
  return messages_.entries[messages_.numbered].boottime_ns;
}

std::vector<GraphChange> Outbox::GraphOf(const std::vector<MessageSeen>& messages,
                                         GraphTrail::Brought& brought) {
  if (messages.empty()) return {};
  return trail_.Bring(messages.front().graph_version, brought);
}

std::vector<MessageSeen> Outbox::PopOldest(const BatchPolicy& policy, int64_t until_ns) {
  std::vector<MessageSeen> taken;
  size_t bytes = 0;
  const auto begin = messages_.entries.begin() + static_cast<ptrdiff_t>(messages_.numbered);
  auto end = begin;
  for (; end != messages_.entries.end() && taken.size() < policy.observations; ++end) {
    if (end->boottime_ns >= until_ns || (!taken.empty() && bytes > policy.bytes)) break;
    if (!taken.empty() && end->graph_version > taken.front().graph_version) break;
    bytes += PayloadBytes(*end);
    messages_.bytes -= CostOf(*end);
    fresh_payload_bytes_ -= PayloadBytes(*end);
    taken.push_back(std::move(*end));
  }
  messages_.entries.erase(begin, end);
  if (messages_.sent == messages_.entries.size()) messages_.urgent = false;
  return taken;
}

void Outbox::CountIdsAlert(const ControlObservation& gone) {
  if (std::holds_alternative<IdsAlert>(gone.what)) ++acknowledged_ids_alerts_;
}

std::vector<ControlObservation> Outbox::PopOldestControl(const BatchPolicy& policy) {
  std::vector<ControlObservation> taken;
  size_t bytes = 0;
  auto& entries = control_.entries;
  const auto begin = entries.begin() + static_cast<ptrdiff_t>(control_.numbered);
  auto end = begin;
  auto kept = begin;
  for (; end != entries.end() && taken.size() < policy.observations; ++end) {
    if (IsGraph(*end)) {
      if (kept != end) *kept = std::move(*end);
      ++kept;
      continue;
    }
    if (!taken.empty() && bytes > policy.bytes) break;
    bytes += CostOf(*end);
    control_.bytes -= CostOf(*end);
    CountIdsAlert(*end);
    taken.push_back(std::move(*end));
  }
  entries.erase(kept, end);
  if (control_.sent == control_.entries.size()) control_.urgent = false;
  return taken;
}

std::vector<MessageSeen> Outbox::DrainMessages(const BatchPolicy& policy) {
  return messages_.Drain(policy, [](const MessageSeen& first, const MessageSeen& next) {
    return next.graph_version <= first.graph_version;
  });
}

std::vector<ControlObservation> Outbox::DrainControl(const BatchPolicy& policy) {
  std::vector<ControlObservation> drained =
      control_.Drain(policy, [](const auto&, const auto&) { return true; });
  for (const ControlObservation& each : drained) CountIdsAlert(each);
  return drained;
}

void Outbox::ShedPayload(MessageSeen& message) {
  if (message.payload == nullptr) return;
  message.payload = nullptr;
  ++shed_payloads_;
}

void Outbox::ShedUnsentPayloads(int64_t before_ns, size_t bytes) {
  for (size_t i = messages_.sent; i < messages_.entries.size(); ++i) {
    const MessageSeen& message = messages_.entries[i];
    if (message.boottime_ns < before_ns && PayloadBytes(message) > bytes) ShedPayloadAt(i);
  }
}

void Outbox::DropSentPayloads(size_t goal, size_t bytes) {
  for (size_t i = 0; i < messages_.sent && messages_.bytes > goal; ++i) {
    MessageSeen& message = messages_.entries[i];
    if (PayloadBytes(message) <= bytes) continue;
    messages_.bytes -= CostOf(message);
    message.payload = nullptr;
    message.payload_dropped = true;
    messages_.bytes += CostOf(message);
  }
}

void Outbox::ShedUnsentPayload(const Payload& payload) {
  for (size_t i = messages_.sent; i < messages_.entries.size(); ++i) {
    if (messages_.entries[i].payload == payload) return ShedPayloadAt(i);
  }
}

// --- Acknowledging and resuming

absl::Status Outbox::Acknowledge(Lane lane, uint64_t sequence) {
  if (lane == Lane::kMessages) {
    const absl::Status forgotten = messages_.Acknowledge(sequence, [](const auto&) {});
    trail_.Advance(OldestVersion(messages_.entries));
    return forgotten;
  }
  return control_.Acknowledge(sequence, [this](const ControlObservation& each) {
    if (IsGraph(each)) graph_base_.Apply(std::get<GraphChange>(each.what));
    CountIdsAlert(each);
  });
}

uint64_t Outbox::acknowledged(Lane lane) const {
  return (lane == Lane::kControl ? control_.first_sequence : messages_.first_sequence) - 1;
}

SequenceRange Outbox::Unacked(Lane lane) const {
  const uint64_t first =
      lane == Lane::kControl ? control_.first_sequence : messages_.first_sequence;
  const size_t count = lane == Lane::kControl ? control_.numbered : messages_.numbered;
  return {.first = first, .last = first + count - 1};
}

void Outbox::Rewind() {
  control_.sent = messages_.sent = 0;
  for (MessageSeen& each : messages_.entries) {
    if (std::exchange(each.payload_dropped, false)) ++shed_payloads_;
  }
}

void Outbox::Renumber() {
  control_.first_sequence = 1;
  control_.numbered = control_.sent = 0;
  messages_.first_sequence = 1;
  messages_.numbered = messages_.sent = 0;
  fresh_payload_bytes_ = 0;
  for (const MessageSeen& each : messages_.entries) fresh_payload_bytes_ += PayloadBytes(each);
  snapshot_wanted_ = true;
}

bool Outbox::GraphStartsWithSnapshot() const {
  const auto first = std::find_if(control_.entries.begin(), control_.entries.end(), IsGraph);
  return first != control_.entries.end() && std::get<GraphChange>(first->what).from_version == 0;
}

bool Outbox::StartGraphWithSnapshot(int64_t now_ns) {
  if (!primary_ || snapshot_wanted_) return false;
  auto& entries = control_.entries;
  const auto first = std::find_if(entries.begin(), entries.end(), IsGraph);
  if (first != entries.end() &&
      first - entries.begin() < static_cast<ptrdiff_t>(control_.numbered)) {
    std::optional<GraphChange> after =
        graph_base_.SnapshotAfter(std::get<GraphChange>(first->what));
    if (!after.has_value()) return false;
    control_.bytes -= CostOf(*first);
    first->what = *std::move(after);
    control_.bytes += CostOf(*first);
    return true;
  }
  if (first != entries.end() &&
      std::get<GraphChange>(first->what).from_version != graph_base_.version()) {
    return false;
  }
  std::optional<GraphChange> base = graph_base_.Snapshot();
  if (!base.has_value()) return false;
  // Not later than what comes after it.
  ControlObservation snapshot{.boottime_ns = first != entries.end() ? first->boottime_ns : now_ns,
                              .what = *std::move(base)};
  control_.bytes += CostOf(snapshot);
  entries.insert(entries.begin() + static_cast<ptrdiff_t>(control_.numbered), std::move(snapshot));
  control_.urgent = true;
  return true;
}

size_t Outbox::DropUnnumberedGraph() {
  graph_base_.Forget();
  size_t dropped = 0;
  auto& entries = control_.entries;
  const auto begin = entries.begin() + static_cast<ptrdiff_t>(control_.numbered);
  const auto kept = std::remove_if(begin, entries.end(), [&](const ControlObservation& each) {
    if (!IsGraph(each)) return false;
    ++dropped;
    control_.bytes -= CostOf(each);
    return true;
  });
  entries.erase(kept, entries.end());
  return dropped;
}

void Outbox::DropGraph(int64_t now_ns) {
  for (size_t i = 0; i < control_.numbered; ++i) {
    ControlObservation& each = control_.entries[i];
    if (!IsGraph(each)) continue;
    control_.bytes -= CostOf(each);
    each.what = Loss{.cause = LossCause::kOutboxShed,
                     .count = 1,
                     .first_boottime_ns = each.boottime_ns,
                     .last_boottime_ns = each.boottime_ns};
    control_.bytes += CostOf(each);
  }
  const size_t left_out = DropUnnumberedGraph();
  if (left_out == 0) return;
  AddLoss({.cause = LossCause::kOutboxShed,
           .count = left_out,
           .first_boottime_ns = now_ns,
           .last_boottime_ns = now_ns});
}

void Outbox::CloseGraph(int64_t now_ns) {
  if (std::none_of(control_.entries.begin(), control_.entries.end(), IsGraph)) return;
  if (GraphStartsWithSnapshot()) return;
  if (!StartGraphWithSnapshot(now_ns)) return DropGraph(now_ns);
  const auto first = std::find_if(control_.entries.begin(), control_.entries.end(), IsGraph);
  if (first - control_.entries.begin() < static_cast<ptrdiff_t>(control_.numbered)) return;
  // A server has judged what it shows: rules are run on the steps after it.
  std::get<GraphChange>(first->what).settled = false;
}

void Outbox::ReplaceGraph(std::vector<GraphChange> snapshot, int64_t now_ns) {
  snapshot_wanted_ = false;
  DropGraph(now_ns);
  if (!primary_ || snapshot.empty()) return;
  std::vector<ControlObservation> parts;
  for (GraphChange& part : snapshot) {
    trail_.Add(part);
    parts.push_back({.boottime_ns = now_ns, .what = std::move(part)});
    control_.bytes += CostOf(parts.back());
  }
  control_.entries.insert(control_.entries.begin() + static_cast<ptrdiff_t>(control_.numbered),
                          std::make_move_iterator(parts.begin()),
                          std::make_move_iterator(parts.end()));
  control_.urgent = true;
}

void Outbox::SetPrimary(bool primary) {
  if (primary == primary_) return;
  primary_ = primary;
  if (primary) {
    snapshot_wanted_ = true;
    return;
  }
  DropUnnumberedGraph();
  trail_.Clear();
  while (messages_.entries.size() > messages_.numbered) {
    messages_.bytes -= CostOf(messages_.entries.back());
    messages_.entries.pop_back();
  }
  fresh_payload_bytes_ = 0;
}

// --- Looking

std::optional<int64_t> Outbox::OldestUnacked() const {
  std::optional<int64_t> oldest;
  if (!control_.entries.empty()) oldest = control_.entries.front().boottime_ns;
  if (!messages_.entries.empty()) {
    const int64_t message_ns = messages_.entries.front().boottime_ns;
    oldest = std::min(oldest.value_or(message_ns), message_ns);
  }
  return oldest;
}

}  // namespace rips::sensor
