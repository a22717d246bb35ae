// Asks a job that runs on another thread to end early.
#ifndef RIPS_SERVICES_RUNTIME_CANCEL_FLAG_H_
#define RIPS_SERVICES_RUNTIME_CANCEL_FLAG_H_

#include "absl/base/thread_annotations.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "services/runtime/mutex.h"

namespace rips {

// Any thread.
class CancelFlag {
 public:
  void Cancel() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    cancelled_ = true;
    changed_.NotifyAll();
  }
  bool cancelled() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return cancelled_;
  }
  // Sleeps up to `duration`; true as soon as it is cancelled.
  bool WaitFor(absl::Duration duration) const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    const absl::Time end = absl::Now() + duration;
    while (!cancelled_ && changed_.WaitFor(lock, end - absl::Now()) && absl::Now() < end) {
    }
    return cancelled_;
  }

 private:
  mutable Mutex mu_;
  mutable CondVar changed_;
  bool cancelled_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_CANCEL_FLAG_H_
