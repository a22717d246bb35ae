#include "sensor_agent/outbox/batch_planner.h"

#include <algorithm>

namespace rips::sensor {

namespace {

// Upper bounds on the wire: of a MessageSeen but for its payload, with its Observation and tags;
// and of incarnation, sequence, time and lane of a batch.
constexpr size_t kMessageBytesMax = 96;
constexpr size_t kBatchBytesMax = 80;

}  // namespace

size_t BatchPlanner::Plan(const Outbox& outbox, Lane lane, const BatchPolicy& policy,
                          uint64_t credit_bytes, const Payload& uploaded) {
  Sent(0);
  if (lane == Lane::kMessages) return PlanMessages(outbox, policy, credit_bytes, uploaded);
  const size_t most = std::min(outbox.unsent(lane), policy.observations);
  size_t bytes = kBatchBytesMax;
  size_t count = 0;
  for (; count < most; ++count) {
    bytes += CostOf(outbox.UnsentControl(count));
    if (count > 0 && bytes > policy.bytes) break;
  }
  return count;
}

size_t BatchPlanner::PlanMessages(const Outbox& outbox, const BatchPolicy& policy,
                                  uint64_t credit_bytes, const Payload& uploaded) {
  const size_t most = std::min(outbox.unsent(Lane::kMessages), policy.observations);
  size_t bytes = kBatchBytesMax;
  size_t payload_bytes = 0;
  for (size_t i = 0; i < most; ++i) {
    const MessageSeen& message = outbox.UnsentMessage(i);
    const bool chunked = IsChunked(message);
    if (chunked && message.payload != uploaded) return i;
    const size_t inline_bytes = chunked ? 0 : PayloadBytes(message);
    bytes += kMessageBytesMax + inline_bytes + IntroductionBytes(message, i);
    payload_bytes += inline_bytes;
    if (bytes > credit_bytes) return i;
    if (chunked) return i + 1;
    if (i > 0 && (bytes > policy.bytes || payload_bytes > kBatchPayloadBytesMax)) return i;
  }
  return most;
}

size_t BatchPlanner::IntroductionBytes(const MessageSeen& message, size_t index) {
  if (!introduced_.insert(message.source).second) return 0;
  planned_.emplace_back(index, message.source);
  const MessageSource& source = *message.source;
  return 3 * 16 + source.topic.size() + source.type.size() + 64 + CostOf(source.writer);
}

void BatchPlanner::Sent(size_t count) {
  for (const auto& [index, source] : planned_) {
    if (index >= count) introduced_.erase(source);
  }
  planned_.clear();
}

}  // namespace rips::sensor
