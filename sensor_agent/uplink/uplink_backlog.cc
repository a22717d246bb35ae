// Uplink: what is not live any more.
#include <algorithm>
#include <limits>
#include <map>
#include <utility>

#include "sensor_agent/uplink/uplink.h"
#include "services/base/check.h"
#include "services/runtime/log.h"

namespace rips::sensor {

namespace {

// Batches set aside while the lock is held once.
constexpr int kSetAsideAtOnce = 8;
// Batches of the backlog are as large whatever the server says: it may say something else by the
// time they are sent.
constexpr BatchPolicy kAsidePolicy = {.observations = 128, .bytes = 32 * 1024};

// What a batch of the backlog grows at most when it takes the numbers of a stream: three ids of an
// observation by two bytes each, and what is written only now.
size_t WireBytesMax(const BacklogBatch& batch) {
  return batch.bytes->size() + 8 * size_t{batch.count} + 64;
}

rips::v1::Lane ToWire(Lane lane) {
  return lane == Lane::kControl ? rips::v1::CONTROL : rips::v1::MESSAGES;
}

int64_t OldestOf(const rips::v1::ObservationBatch& batch) {
  return static_cast<int64_t>(batch.base_boottime_ns());
}

}  // namespace

// --- Setting aside

bool Uplink::OutboxIsFullLocked() const {
  const OutboxLimits& limits = outbox_.limits();
  const bool full = outbox_.message_bytes() > limits.message_bytes / 4 * 3 ||
                    outbox_.control_bytes() > limits.control_bytes / 4 * 3;
  return full && backlog_.HasRoom();
}

bool Uplink::SetAsideLocked(int64_t now_ns) {
  const OutboxLimits& limits = outbox_.limits();
  const int64_t live_ns = absl::ToInt64Nanoseconds(options_.live);
  for (int i = 0; i < kSetAsideAtOnce; ++i) {
    if (!backlog_.HasRoom()) return false;
    if (outbox_.control_bytes() > limits.control_bytes / 4 * 3) {
      const std::vector<ControlObservation> control = outbox_.TakeOldestControl(kAsidePolicy);
      if (!control.empty()) {
        const auto batch = WireEncoder::EncodeAlone(control);
        backlog_.SetAside(Lane::kControl, static_cast<uint32_t>(control.size()), OldestOf(batch),
                          batch.SerializeAsString());
      }
    }
    if (outbox_.message_bytes() > limits.message_bytes / 4 * 3 && phase_ == Phase::kStreaming) {
      // What the server has is judged, if not durably; what it does not have yet comes first.
      outbox_.DropSentPayloads(limits.message_bytes / 8 * 5, kPayloadChunkBytes);
    }
    // Not the message whose payload is on its way: that is the oldest one.
    const bool uploading = phase_ == Phase::kStreaming && stream_->upload.has_value() &&
                           !stream_->upload->backlog.has_value();
    const std::optional<int64_t> oldest_ns = outbox_.OldestUnnumbered();
    if (!oldest_ns.has_value() || uploading) return false;
    int64_t until_ns = 0;
    if (outbox_.message_bytes() > limits.message_bytes / 4 * 3) {
      ShedLatePayloadsLocked(now_ns, /*all=*/true);
    }
    if (outbox_.message_bytes() > limits.message_bytes / 4 * 3) {
      until_ns = std::numeric_limits<int64_t>::max();
    } else if (outbox_.messages_released() &&
               std::max(*oldest_ns, released_ns_) < now_ns - live_ns) {
      // Some younger ones, too, so that batches do not hold one message each.
      until_ns = phase_ == Phase::kDown ? now_ns : now_ns - live_ns / 2;
    } else {
      return false;
    }
    std::vector<MessageSeen> messages = outbox_.TakeOldest(kAsidePolicy, until_ns);
    if (messages.empty()) return false;
    if (backlog_.ShouldShedPayloads()) {
      for (MessageSeen& each : messages) outbox_.ShedPayload(each);
    }
    const auto batch = WireEncoder::EncodeAlone(messages);
    backlog_.SetAside(Lane::kMessages, static_cast<uint32_t>(messages.size()), OldestOf(batch),
                      batch.SerializeAsString());
  }
  return true;
}

// --- Sending

void Uplink::AnnounceLocked(rips::v1::SensorHello& hello) {
  std::vector<BacklogRange> ranges;
  for (const Lane lane : {Lane::kControl, Lane::kMessages}) {
    const SequenceRange range = outbox_.Unacked(lane);
    ranges.push_back({.stream = {.incarnation = incarnation_, .lane = lane},
                      .first_sequence = range.first,
                      .last_sequence = range.last});
  }
  for (BacklogRange& range : backlog_.Rewind()) ranges.push_back(std::move(range));
  std::map<StreamKey, uint64_t> told;
  for (const BacklogRange& range : ranges) {
    const auto known = acknowledged_.find(range.stream);
    if (known != acknowledged_.end()) told.insert(*known);
    rips::v1::SpoolStream* spooled = hello.add_spooled();
    if (known != acknowledged_.end()) spooled->set_acknowledged_sequence(known->second);
    spooled->set_incarnation(range.stream.incarnation);
    spooled->set_first_sequence(range.first_sequence);
    spooled->set_last_sequence(range.last_sequence);
    spooled->set_lane(ToWire(range.stream.lane));
  }
  // What is not announced any more is of no use to anybody.
  acknowledged_ = std::move(told);
}

std::optional<int64_t> Uplink::BacklogDueLocked(int64_t now_ns) const {
  if (phase_ != Phase::kStreaming || outbox_.snapshot_wanted()) return std::nullopt;
  if (stream_->stalled.has_value() || stream_->upload.has_value()) return std::nullopt;
  const int64_t due_ns = std::max(now_ns, backlog_next_ns_);
  if (backlog_.Front(Lane::kControl).has_value()) return due_ns;
  const std::optional<BacklogBatch> next = backlog_.Front(Lane::kMessages);
  if (!next.has_value()) return std::nullopt;
  // A Credit wakes us.
  const uint64_t credit = stream_->credit_granted - stream_->credit_used;
  if (credit <= stream_->credit_window / 2 ||
      stream_->backlog_blocked_at == stream_->credit_granted) {
    return std::nullopt;
  }
  // A longer batch may hold a payload that goes in chunks: that is known when it is parsed.
  const uint64_t bytes = WireBytesMax(*next);
  const uint64_t payload_credit = stream_->payload_granted - stream_->payload_used;
  const bool fits =
      bytes <= kPayloadChunkBytes ? bytes <= credit : payload_credit >= stream_->payload_window / 2;
  if (!fits) return std::nullopt;
  return due_ns;
}

bool Uplink::ParseBacklogBatchLocked(const BacklogBatch& next, rips::v1::ObservationBatch& batch) {
  if (next.bytes == nullptr) return true;
  if (batch.ParseFromString(*next.bytes) &&
      batch.observations_size() == static_cast<int>(next.count)) {
    return true;
  }
  backlog_.Discard(next.stream, next.first_sequence,
                   absl::DataLossError("bytes that are no batch"));
  return false;
}

bool Uplink::UploadOfBacklogLocked(const BacklogBatch& next, rips::v1::ObservationBatch& batch,
                                   int64_t now_ns) {
  PayloadUpload upload{.backlog = next};
  for (int i = 0; i < batch.observations_size(); ++i) {
    if (batch.observations(i).message().payload().size() <= kPayloadChunkBytes) continue;
    std::string* payload = batch.mutable_observations(i)->mutable_message()->mutable_payload();
    // One each batch (TakeOldest, Encode); more are of nobody's making.
    if (upload.sent.payload == nullptr) {
      upload.sent.payload = std::make_shared<const std::string>(std::move(*payload));
      upload.index = i;
    } else {
      batch.mutable_observations(i)->mutable_message()->set_truncated(true);
    }
    payload->clear();
  }
  if (upload.sent.payload == nullptr) return false;
  upload.batch.Swap(&batch);
  BeginUploadLocked(std::move(upload), now_ns);
  return true;
}

bool Uplink::MakeBacklogBatchLocked(const BacklogBatch& next, rips::v1::ObservationBatch& batch) {
  if (next.bytes == nullptr) {
    batch.set_base_boottime_ns(static_cast<uint64_t>(clock_->Now().boottime_ns));
    for (uint32_t i = 0; i < next.count; ++i) {
      rips::v1::Loss* loss = batch.add_observations()->mutable_loss();
      loss->set_cause(rips::v1::Loss::SPOOL_LOST);
      loss->set_count(1);
      loss->set_first_boottime_ns(batch.base_boottime_ns());
      loss->set_last_boottime_ns(batch.base_boottime_ns());
    }
  } else {
    const absl::Status taken = stream_->encoder.Rename(batch);
    if (absl::IsResourceExhausted(taken)) {
      ReopenLocked(std::string(taken.message()));
      return false;
    }
    if (!taken.ok()) {
      backlog_.Discard(next.stream, next.first_sequence, taken);
      return false;
    }
    const int64_t base_ns = static_cast<int64_t>(batch.base_boottime_ns()) + next.time_shift_ns;
    batch.set_base_boottime_ns(static_cast<uint64_t>(std::max<int64_t>(base_ns, 0)));
  }
  batch.set_incarnation(next.stream.incarnation);
  batch.set_first_sequence(next.first_sequence);
  batch.set_lane(ToWire(next.stream.lane));
  return true;
}

bool Uplink::SendBacklogLocked(int64_t now_ns) {
  const std::optional<int64_t> due_ns = BacklogDueLocked(now_ns);
  if (!due_ns.has_value() || *due_ns > now_ns) return false;
  std::optional<BacklogBatch> next = backlog_.Front(Lane::kControl);
  if (!next.has_value()) next = backlog_.Front(Lane::kMessages);
  rips::v1::ObservationBatch batch;
  if (!ParseBacklogBatchLocked(*next, batch)) return false;
  if (next->stream.lane == Lane::kMessages) {
    if (UploadOfBacklogLocked(*next, batch, now_ns)) return false;
    if (stream_->credit_granted - stream_->credit_used < WireBytesMax(*next)) {
      stream_->backlog_blocked_at = stream_->credit_granted;
      return false;
    }
  }
  if (!MakeBacklogBatchLocked(*next, batch)) return false;
  SendBacklogBatchLocked(*next, std::move(batch), now_ns);
  return true;
}

void Uplink::SendBacklogBatchLocked(const BacklogBatch& next, rips::v1::ObservationBatch batch,
                                    int64_t now_ns) {
  rips::v1::SensorMessage message;
  message.mutable_batch()->Swap(&batch);
  const size_t bytes = message.batch().ByteSizeLong();
  if (next.stream.lane == Lane::kMessages) stream_->credit_used += bytes;
  backlog_.MarkSent(next.stream);
  // What went in chunks counts as well.
  const uint64_t paced = next.bytes == nullptr ? bytes : std::max(bytes, next.bytes->size());
  backlog_next_ns_ =
      std::max(backlog_next_ns_, now_ns) +
      static_cast<int64_t>(paced * uint64_t{kNanosPerSecond} / options_.backlog_bytes_per_second);
  batches_.Increment();
  observations_sent_.Increment(next.count);
  if (!SendLocked(message)) stream_->stalled = std::move(message);
}

// --- Looking and ending

void Uplink::ReportStateLocked(int64_t now_ns) {
  const uint64_t shed = outbox_.shed_messages() - shed_reported_;
  shed_reported_ += shed;
  shed_.Increment(static_cast<double>(shed));
  const uint64_t payloads_shed = outbox_.shed_payloads() - payloads_shed_reported_;
  payloads_shed_reported_ += payloads_shed;
  payloads_shed_.Increment(static_cast<double>(payloads_shed));
  const BacklogState backlog = backlog_.state();
  const bool overloaded = shed > 0 || payloads_shed > 0 ||
                          (backlog.disk_refuses && backlog.observations > 0) ||
                          outbox_.bytes() > outbox_.limits().message_bytes / 2;
  std::vector<std::string> blind = BlindLocked();
  const bool news = overloaded || overloaded_ || backlog.observations > 0 || had_backlog_ ||
                    not_visible_ != not_visible_told_ || blind != blind_told_;
  overloaded_ = overloaded;
  had_backlog_ = backlog.observations > 0;
  if (!news) return;
  outbox_.AddState({.overloaded = overloaded,
                    .outbox_bytes = outbox_.bytes() + backlog.memory_bytes,
                    .oldest_unacked_ns = now_ns - OldestUnackedLocked(backlog).value_or(now_ns),
                    .spool_bytes = backlog.disk_bytes,
                    .not_visible = not_visible_,
                    .blind = blind},
                   now_ns);
  not_visible_told_ = not_visible_;
  blind_told_ = std::move(blind);
}

std::optional<int64_t> Uplink::OldestUnackedLocked(const BacklogState& backlog) const {
  const std::optional<int64_t> live_ns = outbox_.OldestUnacked();
  if (!backlog.oldest_ns.has_value()) return live_ns;
  return std::min(live_ns.value_or(*backlog.oldest_ns), *backlog.oldest_ns);
}

void Uplink::LookAtBacklogLocked(int64_t now_ns) {
  const BacklogState backlog = backlog_.state();
  outbox_bytes_.Set(static_cast<double>(outbox_.bytes()));
  backlog_bytes_.Set(static_cast<double>(backlog.memory_bytes));
  spool_bytes_.Set(static_cast<double>(backlog.disk_bytes));
  spool_refuses_.Set(backlog.disk_refuses ? 1 : 0);
  const int64_t age_ns = now_ns - OldestUnackedLocked(backlog).value_or(now_ns);
  oldest_unacked_.Set(static_cast<double>(age_ns) / kNanosPerSecond);
  spool_unreadable_.Increment(static_cast<double>(backlog.unreadable - unreadable_reported_));
  unreadable_reported_ = backlog.unreadable;
  for (Loss& loss : backlog_.TakeLosses()) outbox_.AddLoss(std::move(loss));
  if (backlog.announced_too_much && phase_ != Phase::kDown) {
    ReopenLocked("the end of the backlog that was announced cannot be read");
  }
}

void Uplink::SaveRest() {
  MutexLock lock(&mu_);
  const int64_t now_ns = clock_->Now().boottime_ns;
  for (Loss& loss : backlog_.TakeLosses()) outbox_.AddLoss(std::move(loss));
  // The next process begins with a snapshot; steps of this one's graph lead nowhere.
  const size_t steps = outbox_.DropGraph();
  if (steps > 0) {
    outbox_.AddLoss({.cause = LossCause::kOutboxShed,
                     .count = steps,
                     .first_boottime_ns = now_ns,
                     .last_boottime_ns = now_ns});
  }
  outbox_.FlushMerged(now_ns + outbox_.limits().merge_ns);
  outbox_.Rewind();
  for (const Lane lane : {Lane::kControl, Lane::kMessages}) {
    while (outbox_.unsent(lane) > 0) {
      // Each batch brings all its names, and all its payloads.
      WireEncoder encoder(incarnation_,
                          {.inline_payload_bytes = std::numeric_limits<size_t>::max()});
      const auto batch =
          encoder.Encode(outbox_, lane, kAsidePolicy, std::numeric_limits<uint64_t>::max());
      const auto count = static_cast<uint32_t>(batch.observations_size());
      RIPS_CHECK(count > 0, "nothing was encoded");
      backlog_.Put({.incarnation = incarnation_, .lane = lane}, batch.first_sequence(), count,
                   OldestOf(batch), batch.SerializeAsString());
      outbox_.MarkSent(lane, count);
      RIPS_CHECK(outbox_.Acknowledge(lane, batch.first_sequence() + count - 1).ok(), "was sent");
    }
  }
}

}  // namespace rips::sensor
