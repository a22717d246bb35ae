#include "mode_actuator/link/audit_head_file.h"

#include <optional>

#include "absl/status/statusor.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/log.h"

namespace rips::actuator {
namespace {

absl::StatusOr<model::AuditHead> ReadHead(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(path, kAuditHeadBytesMax));
  return DecodeAuditHead(bytes);
}

}  // namespace

void AuditHeadFile::Load() {
  absl::StatusOr<model::AuditHead> head = ReadHead(path_);
  if (absl::IsNotFound(head.status())) return;
  if (!head.ok()) {
    LogWarning("cannot use the kept audit head; starting without one",
               {{"file", path_}, {"reason", head.status().message()}});
    return;
  }
  MutexLock lock(&mu_);
  keeper_ = AuditHeadKeeper(*std::move(head));
}

void AuditHeadFile::OnLease(const model::AuditHead& head, int64_t boottime_ns, FileWorker& files) {
  std::string trouble;
  std::optional<std::string> bytes;
  {
    MutexLock lock(&mu_);
    trouble = keeper_.OnLease(head);
    bytes = keeper_.TakeWrite(boottime_ns);
  }
  if (!trouble.empty()) LogWarning("audit log contradicted", {{"why", trouble}});
  if (!bytes) return;
  // One that is not written is followed by the next.
  files.Submit({path_, *std::move(bytes), [failures = write_failures_](const absl::Status& status) {
                  if (!status.ok()) failures.Increment();
                }});
}

model::AuditHead AuditHeadFile::head() const {
  MutexLock lock(&mu_);
  return keeper_.head();
}

}  // namespace rips::actuator
