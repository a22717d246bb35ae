// Puts the payloads of one sensor stream together that come in chunks (rips.v1.PayloadChunk).
//
// The chunks of a payload come in order, one payload after the other, before the batch whose
// messages name them. What that batch does not name is dropped.
//
// | chunk or name                                                    | refused as        |
// |------------------------------------------------------------------|-------------------|
// | an id that is neither the newest nor the one after it, or 0      | InvalidArgument   |
// | an offset that is not what came of the payload so far            | InvalidArgument   |
// | no bytes; more of a payload after a chunk that was not full      | InvalidArgument   |
// | more than kPayloadChunkBytes in a chunk                          | ResourceExhausted |
// | more than kPayloadBytesHard of a payload                         | ResourceExhausted |
// | more than kPendingBytesMax or kPendingMax before one batch       | ResourceExhausted |
// | a name of nothing that is there, a second one, one out of order  | InvalidArgument   |
#ifndef RIPS_POLICY_SERVER_SERVER_INGEST_CHUNK_ASSEMBLER_H_
#define RIPS_POLICY_SERVER_SERVER_INGEST_CHUNK_ASSEMBLER_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "rips/v1/sensor.pb.h"
#include "services/base/payload_limits.h"

namespace rips::ingest {

// Not thread-safe. After a refusal the stream must be closed.
class ChunkAssembler {
 public:
  // Payloads and their bytes before one batch. A sensor that gives a payload up begins another.
  static constexpr size_t kPendingMax = 256;
  static constexpr size_t kPendingBytesMax = 2 * size_t{kPayloadBytesHard};

  // Takes the contents of `chunk`.
  absl::Status Add(rips::v1::PayloadChunk& chunk);
  // The payload that a message of the batch names.
  absl::StatusOr<std::string> Claim(uint64_t id);
  // The batch is over: drops what it did not name. Returns the bytes that came before it, named or
  // not.
  size_t FinishBatch();

  size_t pending_bytes() const { return pending_bytes_; }

 private:
  struct Payload {
    std::vector<std::string> chunks;
    size_t bytes = 0;
  };

  // Those of the ids (newest_id_ - pending_.size(), newest_id_].
  std::deque<Payload> pending_;
  uint64_t newest_id_ = 0;
  size_t pending_bytes_ = 0;
  // Named last in this batch; 0 = none.
  uint64_t claimed_id_ = 0;
};

}  // namespace rips::ingest

#endif  // RIPS_POLICY_SERVER_SERVER_INGEST_CHUNK_ASSEMBLER_H_
