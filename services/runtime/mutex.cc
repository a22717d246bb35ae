#include "services/runtime/mutex.h"

#include <algorithm>
#include <chrono>

#include "services/runtime/real_clock.h"

namespace rips {

void CondVar::Wait(MutexLock& lock) {
  std::unique_lock<std::mutex> held(lock.mutex_->mu_, std::adopt_lock);
  condition_.wait(held);
  held.release();
}

bool CondVar::WaitFor(MutexLock& lock, absl::Duration timeout) {
  if (timeout == absl::InfiniteDuration()) {
    Wait(lock);
    return true;
  }
  // A day at a time keeps now + timeout far from overflowing; waking early is allowed.
  const absl::Duration bounded = std::min(timeout, absl::Hours(24));
  std::unique_lock<std::mutex> held(lock.mutex_->mu_, std::adopt_lock);
  const auto deadline = std::chrono::steady_clock::now() + absl::ToChronoNanoseconds(bounded);
  const std::cv_status status = condition_.wait_until(held, deadline);
  held.release();
  return status == std::cv_status::no_timeout || bounded < timeout;
}

bool CondVar::WaitUntil(MutexLock& lock, int64_t boottime_ns) {
  const int64_t remaining_ns = boottime_ns - BoottimeNow();
  if (remaining_ns <= 0) return false;
  WaitFor(lock, std::min(absl::Nanoseconds(remaining_ns), absl::Seconds(1)));
  return BoottimeNow() < boottime_ns;
}

}  // namespace rips
