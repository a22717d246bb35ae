// Uplink: payloads that go in chunks.
#include <algorithm>
#include <utility>

#include "sensor_agent/uplink/uplink.h"
#include "services/runtime/log.h"

namespace rips::sensor {

namespace {

// Chunks that are with the client. Everything else goes before those that are not yet being written
// (SendBulk), so there may be many: each turn between the two threads costs time on a busy machine.
constexpr size_t kUnwrittenMax = 32;

}  // namespace

void Uplink::BeginUploadLocked(PayloadUpload upload, int64_t now_ns) {
  upload.until_ns = now_ns + absl::ToInt64Nanoseconds(options_.live) / 2;
  stream_->upload = std::move(upload);
}

bool Uplink::LineHoldsLocked(size_t chunks) {
  if (client_->bulk_unwritten() < chunks) return false;
  waits_for_line_ = true;
  // What was written in between has not woken us.
  return client_->bulk_unwritten() >= chunks;
}

bool Uplink::SendChunkLocked(PayloadUpload& upload) {
  if (LineHoldsLocked(kUnwrittenMax)) return false;
  const std::string& payload = *upload.sent.payload;
  const size_t bytes = std::min(kPayloadChunkBytes, payload.size() - upload.offset);
  if (stream_->payload_granted - stream_->payload_used < bytes) return false;
  // One that was given up before its first chunk has no number: the server saw nothing of it.
  if (upload.offset == 0) upload.sent.id = ++stream_->last_payload_id;
  rips::v1::SensorMessage message;
  rips::v1::PayloadChunk* chunk = message.mutable_chunk();
  chunk->set_chunked_payload_id(upload.sent.id);
  chunk->set_offset(static_cast<uint32_t>(upload.offset));
  chunk->set_data(payload.data() + upload.offset, bytes);
  if (!client_->SendBulk(std::move(message))) return false;  // the stream has ended
  upload.offset += bytes;
  stream_->payload_used += bytes;
  payload_bytes_.Increment(static_cast<double>(bytes));
  return true;
}

bool Uplink::AdvanceUploadLocked(int64_t now_ns) {
  // The batch goes before chunks that wait: not until they are written.
  while (!stream_->upload->complete() || LineHoldsLocked(1)) {
    if (!stream_->upload->complete() && SendChunkLocked(*stream_->upload)) continue;
    if (now_ns < stream_->upload->until_ns) return false;
    GiveUpUploadLocked(now_ns);
    if (!stream_->upload.has_value()) return true;
    break;
  }
  stream_->upload->written = true;
  if (stream_->upload->backlog.has_value()) return SendUploadedBacklogLocked(now_ns);
  // The message may be gone since, or may be told without its payload.
  if (outbox_.unsent(Lane::kMessages) == 0) {
    stream_->upload.reset();
    return true;
  }
  if (outbox_.snapshot_wanted()) return false;
  if (SendBatchLocked(Lane::kMessages, now_ns)) return !stream_->stalled.has_value();
  // Another upload has begun, or the stream is over, or there is no credit.
  return stream_.has_value() && stream_->upload.has_value() && !stream_->upload->complete();
}

void Uplink::GiveUpUploadLocked(int64_t now_ns) {
  LogDebug("payload dropped: the uplink is too slow",
           {{"bytes", stream_->upload->sent.payload->size()}});
  PayloadUpload& upload = *stream_->upload;
  size_t bytes = 0;
  for (const rips::v1::SensorMessage& each : client_->RecallBulk()) {
    bytes += each.chunk().data().size();
  }
  stream_->payload_used -= bytes;
  // The server has seen nothing of this number.
  if (bytes > 0 && bytes == upload.offset) --stream_->last_payload_id;
  if (upload.backlog.has_value()) {
    MessageSeen shed{.payload = upload.sent.payload};
    outbox_.ShedPayload(shed);
    upload.batch.mutable_observations(upload.index)->mutable_message()->set_truncated(true);
    upload.sent.id = 0;
    upload.offset = upload.sent.payload->size();
    return;
  }
  outbox_.ShedUnsentPayload(upload.sent.payload);
  stream_->upload.reset();
  ShedLatePayloadsLocked(now_ns, /*all=*/false);
}

bool Uplink::SendUploadedBacklogLocked(int64_t now_ns) {
  const PayloadUpload& upload = *stream_->upload;
  const std::optional<BacklogBatch> front = backlog_.Front(Lane::kMessages);
  const bool there = front.has_value() && front->stream == upload.backlog->stream &&
                     front->first_sequence == upload.backlog->first_sequence;
  if (there) {
    if (outbox_.snapshot_wanted()) return false;
    const BacklogBatch next = *upload.backlog;
    rips::v1::ObservationBatch batch = upload.batch;
    if (upload.sent.id != 0) {
      batch.mutable_observations(upload.index)
          ->mutable_message()
          ->set_chunked_payload_id(upload.sent.id);
    }
    // Names of this stream are shorter than the endpoints they stand for, with these bytes to
    // spare.
    const size_t bytes_max = batch.ByteSizeLong() + 8 * size_t{next.count} + 64;
    if (stream_->credit_granted - stream_->credit_used < bytes_max) return false;
    if (!MakeBacklogBatchLocked(next, batch)) {
      if (stream_.has_value()) stream_->upload.reset();
      return stream_.has_value();
    }
    SendBacklogBatchLocked(next, std::move(batch), now_ns);
  }
  stream_->upload.reset();
  return !stream_->stalled.has_value();
}

void Uplink::ShedLatePayloadsLocked(int64_t now_ns, bool all) {
  if (phase_ != Phase::kStreaming || !outbox_.messages_released()) return;
  const int64_t before_ns = now_ns - absl::ToInt64Nanoseconds(options_.live) / 2;
  // What waited for the stream, or for the graph, is not late for that.
  if (std::max(stream_->began_ns, released_ns_) > before_ns) return;
  outbox_.ShedUnsentPayloads(all ? now_ns : before_ns, kPayloadChunkBytes);
}

void Uplink::OnWritten() {
  if (!waits_for_line_.exchange(false)) return;
  MutexLock lock(&mu_);
  WakeLocked();
}

}  // namespace rips::sensor
