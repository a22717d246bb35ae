// Which of the observations that wait make the next batch of a stream.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_BATCH_PLANNER_H_
#define RIPS_SENSOR_AGENT_OUTBOX_BATCH_PLANNER_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_set.h"
#include "sensor_agent/outbox/outbox.h"
#include "services/base/payload_limits.h"

namespace rips::sensor {

// The server takes no batch with more bytes of inline payload.
inline constexpr size_t kBatchPayloadBytesMax = size_t{1} << 20;

// Goes in chunks, ahead of the batch that names it.
inline bool IsChunked(const MessageSeen& message) {
  return PayloadBytes(message) > kPayloadChunkBytes;
}

// Of one stream: the first message of a source takes more room, for the names it introduces. Not
// thread-safe.
class BatchPlanner {
 public:
  // How many of the unsent observations of `lane` go next: as many as `policy` and
  // kBatchPayloadBytesMax allow, at least one if there is one. Of the message lane no more than fit
  // `credit_bytes`, by an upper bound of the serialized batch; so there may be none. A message with
  // a chunked payload is the last of its batch if that payload is `uploaded`; otherwise neither it
  // nor what comes after it is in the batch.
  size_t Plan(const Outbox& outbox, Lane lane, const BatchPolicy& policy, uint64_t credit_bytes,
              const Payload& uploaded = nullptr);
  // Of the batch planned last, so many were sent.
  void Sent(size_t count);

 private:
  size_t PlanMessages(const Outbox& outbox, const BatchPolicy& policy, uint64_t credit_bytes,
                      const Payload& uploaded);
  // What introducing the source of the message at `index` adds; 0 if it was introduced.
  size_t IntroductionBytes(const MessageSeen& message, size_t index);

  // Shared, so that no other source takes the address of one that is gone.
  absl::flat_hash_set<std::shared_ptr<const MessageSource>> introduced_;
  // Those that the batch planned last introduces, by index.
  std::vector<std::pair<size_t, std::shared_ptr<const MessageSource>>> planned_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_BATCH_PLANNER_H_
