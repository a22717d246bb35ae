// The file `audit_head` of an actuator: what decide/audit_head_keeper.h keeps, on the disk.
#ifndef RIPS_MODE_ACTUATOR_LINK_AUDIT_HEAD_FILE_H_
#define RIPS_MODE_ACTUATOR_LINK_AUDIT_HEAD_FILE_H_

#include <cstdint>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "mode_actuator/decide/audit_head_keeper.h"
#include "mode_actuator/steps/workers.h"
#include "services/model/audit_head.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {

class AuditHeadFile {
 public:
  AuditHeadFile(std::string path, Counter write_failures)
      : path_(std::move(path)), write_failures_(write_failures) {}

  // Reads it; one that cannot be used is logged, and none is kept. Blocks on the disk.
  void Load() ABSL_LOCKS_EXCLUDED(mu_);
  // Takes the head of a lease and has it written if it is time. Never blocks.
  void OnLease(const model::AuditHead& head, int64_t boottime_ns, FileWorker& files)
      ABSL_LOCKS_EXCLUDED(mu_);
  // To say hello with. Any thread.
  model::AuditHead head() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  const std::string path_;
  const Counter write_failures_;
  mutable Mutex mu_;
  AuditHeadKeeper keeper_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_LINK_AUDIT_HEAD_FILE_H_
