// The one way from thread to thread: a first-in first-out queue that never grows past its limit.
#ifndef RIPS_SERVICES_RUNTIME_BOUNDED_QUEUE_H_
#define RIPS_SERVICES_RUNTIME_BOUNDED_QUEUE_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "services/base/check.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips {

// What Push does when the queue holds `capacity` items.
enum class OnFull {
  kRefuse,      // the new item is lost
  kDropOldest,  // the front item is lost
};

// Any number of producers and consumers, any thread. Items are destroyed outside the lock.
template <typename T>
class BoundedQueue {
 public:
  struct Options {
    size_t capacity = 0;  // items, at least 1
    OnFull on_full = OnFull::kRefuse;
  };

  explicit BoundedQueue(Options options) : options_(options) {
    RIPS_CHECK(options.capacity > 0, "a queue needs a capacity");
  }

  // False if `item` was not taken: the queue is closed (not counted), or full under kRefuse
  // (counted in dropped()). Under kDropOldest always true unless closed. Never blocks.
  bool Push(T item) ABSL_LOCKS_EXCLUDED(mu_) {
    std::optional<T> oldest;
    MutexLock lock(&mu_);
    if (closed_) return false;
    if (items_.size() >= options_.capacity) {
      ++dropped_;
      if (options_.on_full == OnFull::kRefuse) return false;
      oldest.emplace(std::move(items_.front()));
      items_.pop_front();
    }
    items_.push_back(std::move(item));
    changed_.NotifyOne();
    return true;
  }

  // The oldest item, waiting for one up to `timeout` (ZeroDuration = do not wait). nullopt if none
  // came, or the queue is closed and empty.
  std::optional<T> Pop(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (!WaitForItems(lock, timeout)) return std::nullopt;
    std::optional<T> item(std::move(items_.front()));
    items_.pop_front();
    return item;
  }

  // As Pop, but takes up to `max` items at once, oldest first. Empty if none came in time.
  std::vector<T> PopAll(absl::Duration timeout, size_t max = SIZE_MAX) ABSL_LOCKS_EXCLUDED(mu_) {
    std::vector<T> batch;
    MutexLock lock(&mu_);
    if (!WaitForItems(lock, timeout)) return batch;
    const size_t count = std::min(max, items_.size());
    batch.reserve(count);
    for (size_t i = 0; i < count; ++i) {
      batch.push_back(std::move(items_.front()));
      items_.pop_front();
    }
    return batch;
  }

  // From now on nothing is taken in; what is inside can still be popped; waiters wake.
  void Close() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    closed_ = true;
    changed_.NotifyAll();
  }

  bool closed() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return closed_;
  }
  size_t size() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return items_.size();
  }
  // Items lost to the limit since construction.
  uint64_t dropped() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return dropped_;
  }

 private:
  // True once there is an item; false on timeout or when closed and empty.
  bool WaitForItems(MutexLock& lock, absl::Duration timeout) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    const int64_t deadline_ns = BoottimeAfter(timeout);
    while (items_.empty() && !closed_) {
      if (timeout <= absl::ZeroDuration() || !changed_.WaitUntil(lock, deadline_ns)) break;
    }
    return !items_.empty();
  }

  const Options options_;
  mutable Mutex mu_;
  CondVar changed_;
  std::deque<T> items_ ABSL_GUARDED_BY(mu_);
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
  uint64_t dropped_ ABSL_GUARDED_BY(mu_) = 0;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_BOUNDED_QUEUE_H_
