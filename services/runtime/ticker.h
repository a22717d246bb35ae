#ifndef RIPS_SERVICES_RUNTIME_TICKER_H_
#define RIPS_SERVICES_RUNTIME_TICKER_H_

#include <functional>
#include <thread>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "services/runtime/mutex.h"

namespace rips {

// Calls a function again and again on a thread of its own.
class Ticker {
 public:
  // Calls `tick` after `first`, and then each time after the delay that it returns;
  // InfiniteDuration = never.
  Ticker(absl::Duration first, std::function<absl::Duration()> tick)
      : tick_(std::move(tick)), thread_([this, first] {
          for (absl::Duration delay = first; Wait(delay);) delay = tick_();
        }) {}
  // Waits for the end of a running call. Not from within one.
  ~Ticker() {
    {
      MutexLock lock(&mu_);
      stopping_ = true;
      stop_cond_.NotifyAll();
    }
    thread_.join();
  }

 private:
  // False if stopped meanwhile.
  bool Wait(absl::Duration delay) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    while (!stopping_ && stop_cond_.WaitFor(lock, delay)) {
    }
    return !stopping_;
  }

  const std::function<absl::Duration()> tick_;
  Mutex mu_;
  CondVar stop_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;  // last: uses the others
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_TICKER_H_
