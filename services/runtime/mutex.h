// The mutex of this project: std::mutex with clang's thread-safety annotations. absl::Mutex is not
// used because ThreadSanitizer cannot see into Debian's uninstrumented abseil.
#ifndef RIPS_SERVICES_RUNTIME_MUTEX_H_
#define RIPS_SERVICES_RUNTIME_MUTEX_H_

#include <condition_variable>
#include <cstdint>
#include <mutex>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"

namespace rips {

class ABSL_LOCKABLE Mutex {
 public:
  Mutex() = default;
  Mutex(const Mutex&) = delete;
  Mutex& operator=(const Mutex&) = delete;

  void Lock() ABSL_EXCLUSIVE_LOCK_FUNCTION() { mu_.lock(); }
  void Unlock() ABSL_UNLOCK_FUNCTION() { mu_.unlock(); }

 private:
  friend class CondVar;
  std::mutex mu_;
};

class ABSL_SCOPED_LOCKABLE [[nodiscard]] MutexLock {
 public:
  explicit MutexLock(Mutex* mutex) ABSL_EXCLUSIVE_LOCK_FUNCTION(mutex) : mutex_(mutex) {
    mutex_->Lock();
  }
  ~MutexLock() ABSL_UNLOCK_FUNCTION() { mutex_->Unlock(); }
  MutexLock(const MutexLock&) = delete;
  MutexLock& operator=(const MutexLock&) = delete;

 private:
  friend class CondVar;
  Mutex* mutex_;
};

// Every wait may end without a notification: call it in a loop that tests the condition.
//   MutexLock lock(&mu_);
//   while (!ready_) changed_.Wait(lock);
class CondVar {
 public:
  void NotifyOne() { condition_.notify_one(); }
  void NotifyAll() { condition_.notify_all(); }

  void Wait(MutexLock& lock);
  // Waits at most `timeout` (CLOCK_MONOTONIC; InfiniteDuration allowed). False if it passed.
  bool WaitFor(MutexLock& lock, absl::Duration timeout);
  // Waits until `boottime_ns` of CLOCK_BOOTTIME (Instant::boottime_ns of a real clock), or 1 s,
  // whichever is first, so that time spent suspended is noticed. False if the deadline has passed.
  bool WaitUntil(MutexLock& lock, int64_t boottime_ns);

 private:
  std::condition_variable condition_;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_MUTEX_H_
