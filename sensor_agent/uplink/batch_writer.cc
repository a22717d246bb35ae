#include "sensor_agent/uplink/batch_writer.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "services/base/payload_limits.h"

namespace rips::sensor {

namespace {

using rips::v1::ObservationBatch;
using rips::v1::SensorMessage;

// The id of a payload that went in chunks.
constexpr size_t kChunkedIdBytesMax = 16;

rips::v1::Lane ToWire(Lane lane) {
  return lane == Lane::kControl ? rips::v1::CONTROL : rips::v1::MESSAGES;
}

void AddSpoolLosses(uint32_t count, int64_t now_ns, ObservationBatch& batch) {
  batch.set_base_boottime_ns(static_cast<uint64_t>(now_ns));
  for (uint32_t i = 0; i < count; ++i) {
    rips::v1::Loss* loss = batch.add_observations()->mutable_loss();
    loss->set_cause(rips::v1::Loss::SPOOL_LOST);
    loss->set_count(1);
    loss->set_first_boottime_ns(batch.base_boottime_ns());
    loss->set_last_boottime_ns(batch.base_boottime_ns());
  }
}

}  // namespace

Encoded EncodeAlone(const EncodeForBacklog& action) {
  return std::visit(
      [&](const auto& observations) {
        ObservationBatch batch = WireEncoder::EncodeAlone(observations);
        WireEncoder::AddGraph(action.graph, batch);
        return Encoded{.stream = action.stream,
                       .first_sequence = action.first_sequence,
                       .count = static_cast<uint32_t>(observations.size()),
                       .oldest_ns = static_cast<int64_t>(batch.base_boottime_ns()),
                       .bytes = batch.SerializeAsString()};
      },
      action.observations);
}

BatchSent BatchWriter::Send(const SendBatch& action, const Outbox& outbox, UplinkClient& client) {
  if (!client.HasRoom()) return {.status = SendStatus::kLineFull};
  SensorMessage message;
  *message.mutable_batch() = encoder_.Encode(outbox, action.lane, action.count, action.chunked_id);
  const auto count = static_cast<size_t>(message.batch().observations_size());
  if (count == 0) return {.status = SendStatus::kNamesUsedUp};
  const uint64_t bytes = message.batch().ByteSizeLong();
  // If the stream has ended by now, all of it is sent again on the next one.
  client.Send(std::move(message));
  return {.count = count, .bytes = bytes};
}

ChunkSent BatchWriter::Send(const SendChunk& action, UplinkClient& client) {
  SensorMessage message;
  rips::v1::PayloadChunk* chunk = message.mutable_chunk();
  chunk->set_chunked_payload_id(action.id);
  chunk->set_offset(static_cast<uint32_t>(action.offset));
  chunk->set_data(action.payload->data() + action.offset, action.bytes);
  return {.sent = client.SendBulk(std::move(message))};
}

// --- The backlog

BacklogOpened BatchWriter::Open(const OpenBacklog& action, int64_t now_ns) {
  origin_ = action.batch;
  opened_.Clear();
  chunked_index_ = -1;
  if (origin_.bytes == nullptr) {
    AddSpoolLosses(origin_.count, now_ns, opened_);
    return {};
  }
  if (!opened_.ParseFromString(*origin_.bytes) ||
      opened_.observations_size() != static_cast<int>(origin_.count)) {
    return {.status = SendStatus::kMalformed};
  }
  if (origin_.stream.lane == Lane::kControl) return {};
  BacklogOpened result{.chunked = DetachChunkedPayload()};
  const uint64_t bytes = result.chunked == nullptr ? origin_.bytes->size()
                                                   : opened_.ByteSizeLong() + kChunkedIdBytesMax;
  result.bytes_max = BacklogBytesMax(bytes, origin_.count);
  return result;
}

Payload BatchWriter::DetachChunkedPayload() {
  Payload chunked;
  for (int i = 0; i < opened_.observations_size(); ++i) {
    if (opened_.observations(i).message().payload().size() <= kPayloadChunkBytes) continue;
    rips::v1::MessageSeen* message = opened_.mutable_observations(i)->mutable_message();
    if (chunked == nullptr) {
      chunked = std::make_shared<const std::string>(std::move(*message->mutable_payload()));
      chunked_index_ = i;
    } else {
      message->set_truncated(true);
    }
    message->clear_payload();
  }
  return chunked;
}

BacklogSent BatchWriter::Send(const SendBacklog& action, UplinkClient& client) {
  if (!client.HasRoom()) return {.status = SendStatus::kLineFull};
  if (chunked_index_ >= 0) {
    rips::v1::MessageSeen* message =
        opened_.mutable_observations(chunked_index_)->mutable_message();
    if (action.chunked_id == 0) {
      message->set_truncated(true);
    } else {
      message->set_chunked_payload_id(action.chunked_id);
    }
  }
  if (origin_.bytes != nullptr) {
    const absl::Status renamed = encoder_.Rename(opened_);
    if (absl::IsResourceExhausted(renamed)) return {.status = SendStatus::kNamesUsedUp};
    if (!renamed.ok()) return {.status = SendStatus::kMalformed};
    const int64_t base_ns =
        static_cast<int64_t>(opened_.base_boottime_ns()) + origin_.time_shift_ns;
    opened_.set_base_boottime_ns(static_cast<uint64_t>(std::max<int64_t>(base_ns, 0)));
  }
  opened_.set_incarnation(origin_.stream.incarnation);
  opened_.set_first_sequence(origin_.first_sequence);
  opened_.set_lane(ToWire(origin_.stream.lane));
  SensorMessage message;
  message.mutable_batch()->Swap(&opened_);
  const uint64_t bytes = message.batch().ByteSizeLong();
  client.Send(std::move(message));
  return {.count = origin_.count, .bytes = bytes};
}

}  // namespace rips::sensor
