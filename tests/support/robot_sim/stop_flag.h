// Ends a loop that waits.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_STOP_FLAG_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_STOP_FLAG_H_

#include "absl/base/thread_annotations.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "services/runtime/mutex.h"

namespace rips::robot_sim {

// Any thread.
class StopFlag {
 public:
  void Stop() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    stopped_ = true;
    stop_cond_.NotifyAll();
  }

  // Waits for `timeout`, or until Stop was called. True if it was.
  bool WaitFor(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_) {
    const absl::Time deadline = absl::Now() + timeout;
    MutexLock lock(&mu_);
    while (!stopped_ && stop_cond_.WaitFor(lock, deadline - absl::Now())) {
    }
    return stopped_;
  }

 private:
  Mutex mu_;
  CondVar stop_cond_;
  bool stopped_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_STOP_FLAG_H_
