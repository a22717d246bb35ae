#include "sensor_agent/outbox/send_session.h"

#include <algorithm>
#include <utility>

#include "services/base/clock.h"

namespace rips::sensor {

namespace {

// What was left of the control lane goes ahead of what is live if it is read in this time after the
// stream has begun: the server then judges the graph in the order of its changes.
constexpr int64_t kBacklogFirstNs = 500 * kNanosPerMilli;
// A full line is tried again after this.
constexpr int64_t kLineRetryNs = 10 * kNanosPerMilli;

int Index(Lane lane) { return lane == Lane::kControl ? 0 : 1; }

}  // namespace

std::optional<UplinkAction> SendSession::Next(int64_t now_ns) {
  if (now_ns < retry_ns_) return std::nullopt;
  if (ready_.has_value()) return *ready_;
  std::optional<UplinkAction> action;
  while (true) {
    switch (turn_) {
      case Kind::kBacklog:
        if (upload_.has_value()) {
          action = NextControl(now_ns);
          if (!action.has_value()) action = NextUploaded(now_ns);
          // It waits otherwise.
          if (action.has_value() || upload_.has_value()) return action;
        }
        turn_ = Kind::kControl;
        action = NextOfBacklog(now_ns);
        progress_ = action.has_value();
        if (progress_) return action;
        break;
      case Kind::kControl:
        if (!upload_.has_value()) action = NextControl(now_ns);
        if (action.has_value()) return action;
        turn_ = Kind::kMessages;
        break;
      case Kind::kMessages:
        if (!upload_.has_value() && LiveDue(Lane::kMessages, now_ns) == now_ns) {
          action = NextMessages(now_ns);
        }
        if (action.has_value()) return action;
        turn_ = Kind::kBacklog;
        if (!progress_ && !upload_.has_value()) return std::nullopt;
        break;
    }
  }
}

std::optional<int64_t> SendSession::LiveDue(Lane lane, int64_t now_ns) const {
  std::optional<int64_t> due =
      kept_.outbox.DueAt(lane, kept_.policy, last_batch_ns_[Index(lane)], now_ns);
  if (due.has_value() && lane == Lane::kControl && kept_.backlog.HasUnsent(lane)) {
    due = std::max(*due, began_ns_ + kBacklogFirstNs);
  }
  return due;
}

std::optional<UplinkAction> SendSession::NextControl(int64_t now_ns) {
  if (LiveDue(Lane::kControl, now_ns) != now_ns) return std::nullopt;
  kept_.outbox.FlushMerged(now_ns);
  const size_t count = planner_.Plan(kept_.outbox, Lane::kControl, kept_.policy, 0);
  if (count == 0) return std::nullopt;
  sending_ = Lane::kControl;
  return SendBatch{.lane = Lane::kControl, .count = count};
}

std::optional<UplinkAction> SendSession::NextMessages(int64_t now_ns) {
  Outbox& outbox = kept_.outbox;
  const Payload uploaded = upload_.has_value() ? upload_->payload : nullptr;
  const auto needs_upload = [&] {
    const MessageSeen& first = outbox.UnsentMessage(0);
    return IsChunked(first) && first.payload != uploaded;
  };
  if (needs_upload()) {
    ShedLatePayloads(now_ns, /*all=*/false);
    if (needs_upload()) {
      BeginUpload({.payload = outbox.UnsentMessage(0).payload}, now_ns);
      return std::nullopt;
    }
  }
  const size_t count =
      planner_.Plan(outbox, Lane::kMessages, kept_.policy, messages.left(), uploaded);
  if (count == 0) {
    exhausted_at_ = messages.granted;
    return std::nullopt;
  }
  sending_ = Lane::kMessages;
  const bool names_upload =
      uploaded != nullptr && outbox.UnsentMessage(count - 1).payload == uploaded;
  return SendBatch{
      .lane = Lane::kMessages, .count = count, .chunked_id = names_upload ? upload_->id : 0};
}

void SendSession::On(const BatchSent& result, int64_t now_ns) {
  if (result.status == SendStatus::kLineFull) {
    retry_ns_ = now_ns + kLineRetryNs;
    return;
  }
  if (result.status != SendStatus::kSent) {
    names_used_up_ = true;
    return;
  }
  planner_.Sent(result.count);
  kept_.outbox.MarkSent(sending_, result.count);
  last_batch_ns_[Index(sending_)] = now_ns;
  if (sending_ == Lane::kControl) return;
  messages.used += result.bytes;
  upload_.reset();
}

// --- Payloads in chunks

void SendSession::BeginUpload(PayloadUpload upload, int64_t now_ns) {
  upload.until_ns = now_ns + kept_.live_ns / 2;
  upload_ = std::move(upload);
}

std::optional<UplinkAction> SendSession::NextUploaded(int64_t now_ns) {
  using Stage = PayloadUpload::Stage;
  PayloadUpload& upload = *upload_;
  if (upload.stage == Stage::kChunks && upload.offset == upload.payload->size()) {
    upload.stage = Stage::kAwaited;
    upload.blocked = true;
    return AwaitLine{};
  }
  if (upload.stage == Stage::kChunks && !upload.blocked &&
      payloads.left() >= upload.NextChunk().bytes) {
    if (upload.offset == 0) upload.id = ++last_payload_id_;
    return upload.NextChunk();
  }
  if (upload.stage != Stage::kReady) {
    if (now_ns < upload.until_ns) return std::nullopt;
    return TakeChunksBack{};
  }
  if (!upload.backlog.has_value()) {
    // The message may be gone since, or may go without its payload.
    if (kept_.outbox.unsent(Lane::kMessages) == 0) {
      upload_.reset();
      return std::nullopt;
    }
    if (kept_.outbox.snapshot_wanted()) return std::nullopt;
    const Payload payload = upload.payload;
    std::optional<UplinkAction> action = NextMessages(now_ns);
    const bool another = upload_.has_value() && upload_->payload != payload;
    return another && !action.has_value() ? NextUploaded(now_ns) : std::move(action);
  }
  const std::optional<BacklogBatch> front = kept_.backlog.Front(Lane::kMessages);
  const bool there = front.has_value() && front->stream == upload.backlog->stream &&
                     front->first_sequence == upload.backlog->first_sequence;
  if (!there) {
    upload_.reset();
    return std::nullopt;
  }
  if (kept_.outbox.snapshot_wanted() || messages.left() < upload.bytes_max) return std::nullopt;
  ready_ = SendBacklog{.chunked_id = upload.id};
  return *ready_;
}

void SendSession::On(const ChunkSent& result) {
  PayloadUpload& upload = *upload_;
  if (!result.sent) {
    // The server saw nothing of a number before its first chunk.
    if (upload.offset == 0) --last_payload_id_;
    upload.blocked = true;
    return;
  }
  const size_t bytes = upload.NextChunk().bytes;
  upload.offset += bytes;
  payloads.used += bytes;
}

void SendSession::OnLineFree() {
  if (!upload_.has_value() || !upload_->blocked) return;
  upload_->blocked = false;
  if (upload_->stage == PayloadUpload::Stage::kAwaited) {
    upload_->stage = PayloadUpload::Stage::kReady;
  }
}

void SendSession::On(const ChunksTakenBack& result, int64_t now_ns) {
  PayloadUpload& upload = *upload_;
  payloads.used -= result.bytes;
  // The server has seen nothing of this number.
  if (result.bytes > 0 && result.bytes == upload.offset) --last_payload_id_;
  if (!upload.backlog.has_value()) {
    kept_.outbox.ShedUnsentPayload(upload.payload);
    upload_.reset();
    ShedLatePayloads(now_ns, /*all=*/false);
    return;
  }
  MessageSeen shed{.payload = upload.payload};
  kept_.outbox.ShedPayload(shed);
  upload.id = 0;
  upload.stage = PayloadUpload::Stage::kReady;
}

void SendSession::ShedLatePayloads(int64_t now_ns, bool all) {
  if (!kept_.outbox.messages_released()) return;
  const int64_t before_ns = now_ns - kept_.live_ns / 2;
  // What waited for the stream, or for the graph, is not late for that.
  if (std::max(began_ns_, kept_.released_ns) > before_ns) return;
  kept_.outbox.ShedUnsentPayloads(all ? now_ns : before_ns, kPayloadChunkBytes);
}

// --- The backlog

std::optional<int64_t> SendSession::BacklogDue(int64_t now_ns) const {
  if (kept_.outbox.snapshot_wanted() || upload_.has_value()) return std::nullopt;
  const int64_t due_ns = std::max(now_ns, kept_.backlog_next_ns);
  if (kept_.backlog.Front(Lane::kControl).has_value()) return due_ns;
  const std::optional<BacklogBatch> next = kept_.backlog.Front(Lane::kMessages);
  if (!next.has_value()) return std::nullopt;
  // A CreditReceived changes this.
  if (messages.left() <= messages.window / 2 || backlog_blocked_at_ == messages.granted) {
    return std::nullopt;
  }
  // A longer batch may hold a payload that goes in chunks: that is known when it is opened.
  const uint64_t bytes = BacklogBytesMax(next->bytes->size(), next->count);
  const bool fits = bytes <= kPayloadChunkBytes ? bytes <= messages.left()
                                                : payloads.left() >= payloads.window / 2;
  return fits ? std::optional<int64_t>(due_ns) : std::nullopt;
}

std::optional<UplinkAction> SendSession::NextOfBacklog(int64_t now_ns) {
  if (BacklogDue(now_ns) != now_ns) return std::nullopt;
  opened_ = kept_.backlog.Front(Lane::kControl);
  if (!opened_.has_value()) opened_ = kept_.backlog.Front(Lane::kMessages);
  return OpenBacklog{.batch = *opened_};
}

BacklogLost SendSession::Lost(const BacklogBatch& batch, int64_t now_ns) {
  kept_.backlog.Discard(batch.stream, batch.first_sequence, now_ns);
  return {.first_sequence = batch.first_sequence,
          .why = absl::DataLossError("the batch cannot be decoded")};
}

std::optional<BacklogLost> SendSession::On(const BacklogOpened& result, int64_t now_ns) {
  if (result.status == SendStatus::kMalformed) return Lost(*opened_, now_ns);
  if (result.chunked != nullptr) {
    BeginUpload({.payload = result.chunked, .backlog = *opened_, .bytes_max = result.bytes_max},
                now_ns);
  } else if (opened_->stream.lane == Lane::kMessages && messages.left() < result.bytes_max) {
    backlog_blocked_at_ = messages.granted;
  } else {
    ready_ = SendBacklog{};
  }
  return std::nullopt;
}

std::optional<BacklogLost> SendSession::On(const BacklogSent& result, int64_t now_ns) {
  if (result.status == SendStatus::kLineFull) {
    retry_ns_ = now_ns + kLineRetryNs;
    return std::nullopt;
  }
  ready_.reset();
  upload_.reset();
  if (result.status == SendStatus::kNamesUsedUp) {
    names_used_up_ = true;
    return std::nullopt;
  }
  if (result.status == SendStatus::kMalformed) return Lost(*opened_, now_ns);
  if (opened_->stream.lane == Lane::kMessages) messages.used += result.bytes;
  kept_.backlog.MarkSent(opened_->stream);
  // What went in chunks counts as well.
  const uint64_t held = opened_->bytes == nullptr ? 0 : opened_->bytes->size();
  kept_.backlog_next_ns =
      std::max(kept_.backlog_next_ns, now_ns) +
      static_cast<int64_t>(std::max(result.bytes, held) * uint64_t{kNanosPerSecond} /
                           kept_.backlog_bytes_per_second);
  return std::nullopt;
}

int64_t SendSession::NextDue(int64_t now_ns) const {
  if (now_ns < retry_ns_) return retry_ns_;
  int64_t due_ns = kNever;
  const auto include = [&](std::optional<int64_t> at_ns) {
    due_ns = std::min(due_ns, at_ns.value_or(kNever));
  };
  if (upload_.has_value() && upload_->stage != PayloadUpload::Stage::kReady) {
    include(std::max(now_ns, upload_->until_ns));
  }
  include(BacklogDue(now_ns));
  include(LiveDue(Lane::kControl, now_ns));
  if (!upload_.has_value() && exhausted_at_ != messages.granted) {
    include(LiveDue(Lane::kMessages, now_ns));
  }
  return due_ns;
}

}  // namespace rips::sensor
