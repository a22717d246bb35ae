// The server's audit log: what many threads record, sealed in groups.
#ifndef RIPS_POLICY_SERVER_SERVER_AUDIT_AUDIT_LOG_H_
#define RIPS_POLICY_SERVER_SERVER_AUDIT_AUDIT_LOG_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/server/audit/segment_writer.h"
#include "rips/v1/audit.pb.h"
#include "services/base/clock.h"
#include "services/model/audit_head.h"
#include "services/runtime/mutex.h"

namespace rips::audit {

struct AuditOptions {
  std::string directory;
  // A segment that has so many bytes is followed by the next one.
  uint64_t segment_bytes = 64ull << 20;
  // Records of Add that wait for a log that cannot be written; the oldest go first, and are
  // counted in the log when it can.
  size_t waiting_max = 10'000;
  // Called for each attempt to write that failed; may be empty. Any thread.
  std::function<void()> on_failure = {};
};

class AuditLog {
 public:
  // Records that the log was opened. Errors as SegmentWriter::Open. `clock` outlives this.
  static absl::StatusOr<std::unique_ptr<AuditLog>> Open(const AuditOptions& options,
                                                        const Clock* clock);
  // Writes what waits, once.
  ~AuditLog();

  // Durable when it returns OK, behind all that waits; otherwise not recorded, and the caller is
  // told why: ResourceExhausted for a full disk. Texts are cut. Without records: mends a log that
  // failed, if it can. Any thread; blocks on the disk.
  absl::Status Commit(std::vector<v1::AuditRecord> records) ABSL_LOCKS_EXCLUDED(file_mu_, mu_);
  // Kept until it is written, soon. Any thread; never blocks on the disk.
  void Add(v1::AuditRecord record) ABSL_LOCKS_EXCLUDED(mu_);

  // Not OK, with the reason, from an attempt that failed until one that did not.
  absl::Status health() const ABSL_LOCKS_EXCLUDED(mu_);
  Head head() const ABSL_LOCKS_EXCLUDED(mu_);
  // The same with its proof. Any thread; never blocks on the disk.
  model::AuditHead sealed() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  AuditLog(std::unique_ptr<SegmentWriter> writer, const AuditOptions& options, const Clock* clock);
  void Run();
  absl::Status Write(std::vector<v1::AuditRecord>& records, bool wants_gap)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(file_mu_);

  const AuditOptions options_;
  const Clock* clock_;
  Mutex file_mu_;  // before mu_
  std::unique_ptr<SegmentWriter> writer_ ABSL_GUARDED_BY(file_mu_);
  mutable Mutex mu_;
  CondVar changed_;
  // Of stopping_ alone: what is added does not cut short the wait between two attempts.
  CondVar stopped_;
  std::deque<v1::AuditRecord> waiting_ ABSL_GUARDED_BY(mu_);
  uint64_t dropped_ ABSL_GUARDED_BY(mu_) = 0;
  absl::Status health_ ABSL_GUARDED_BY(mu_);
  int64_t failed_unix_ns_ ABSL_GUARDED_BY(mu_) = 0;
  Head head_ ABSL_GUARDED_BY(mu_);
  model::AuditHead sealed_ ABSL_GUARDED_BY(mu_);
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_SERVER_AUDIT_AUDIT_LOG_H_
