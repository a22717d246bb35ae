// Appends to the segments of an audit log: files, keys, durability.
//
// In the directory: the segments, `key` (the private key of the last segment, mode 0600), `lock`,
// and `key.next` while a segment is begun. Nothing that was sealed is ever changed.
#ifndef RIPS_POLICY_SERVER_SERVER_AUDIT_SEGMENT_WRITER_H_
#define RIPS_POLICY_SERVER_SERVER_AUDIT_SEGMENT_WRITER_H_

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "policy_server/audit/format.h"
#include "policy_server/audit/signing_key.h"
#include "policy_server/audit/verify.h"
#include "services/model/audit_head.h"
#include "services/runtime/unique_fd.h"

namespace rips::audit {

// One thread at a time.
class SegmentWriter {
 public:
  // Continues the log in `directory`, or begins one there. Bytes that a crash left behind the last
  // seal stay where they are; a new segment follows. DataLoss: what is there was altered, or its
  // key is gone, so it cannot be continued; FailedPrecondition: another process writes it;
  // Unavailable and others: the directory cannot be used.
  static absl::StatusOr<std::unique_ptr<SegmentWriter>> Open(const std::string& directory,
                                                             uint64_t segment_bytes,
                                                             int64_t unix_ns);

  // Each a record of at most kPayloadBytesMax, at least one; sealed and durable together when it
  // returns OK. After an error none of them is part of the log, and it may be tried again.
  absl::Status Append(absl::Span<const std::string> payloads, int64_t unix_ns);

  // The newest that is durable.
  const Head& head() const { return head_; }
  // The same with its proof; none until the first Append.
  const model::AuditHead& sealed() const { return sealed_; }
  uint64_t segment() const { return number_; }

 private:
  SegmentWriter(std::string directory, uint64_t segment_bytes)
      : directory_(std::move(directory)), segment_bytes_(segment_bytes) {}

  std::string PathOf(absl::string_view name) const;
  absl::Status Lock();
  absl::Status Continue(const std::string& name);
  // The key of the last segment, also if a crash came between its header and its key.
  absl::Status FindKey(const std::string& public_key);
  absl::Status BeginSegment(int64_t unix_ns);
  absl::Status OpenSegment();
  absl::Status Write(absl::string_view bytes);

  const std::string directory_;
  const uint64_t segment_bytes_;
  UniqueFd lock_;
  UniqueFd file_;
  std::optional<SigningKey> key_;
  uint64_t number_ = 0;
  // End of the last seal, and its hash; of the header if there is none.
  uint64_t bytes_ = 0;
  std::string hash_ = std::string(kHashBytes, '\0');
  Head head_;
  model::AuditHead sealed_;
  // More than `bytes_` may stand in the file.
  bool torn_ = false;
};

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_SERVER_AUDIT_SEGMENT_WRITER_H_
