// What waits to be written to a stream: in order, but for bulk, which everything else goes before.
#ifndef RIPS_SERVICES_RPC_OUTGOING_QUEUE_H_
#define RIPS_SERVICES_RPC_OUTGOING_QUEUE_H_

#include <cstddef>
#include <deque>
#include <iterator>
#include <optional>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

// Any number of producers, one consumer: Pop, then Written, and so on.
template <typename T>
class OutgoingQueue {
 public:
  // Items of each kind that may wait.
  explicit OutgoingQueue(size_t capacity) : capacity_(capacity) {}

  // False, and nothing is kept, if too many wait or the queue is closed. Never blocks.
  bool Push(T item) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return PushTo(items_, std::move(item));
  }
  bool PushBulk(T item) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return PushTo(bulk_, std::move(item));
  }

  // Push would keep an item now.
  bool HasRoom() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return !closed_ && items_.size() < capacity_;
  }

  // Waits for an item: the oldest that is not bulk, else the oldest of bulk. nullopt once the queue
  // is closed; what it holds then is lost.
  std::optional<T> Pop() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    while (!closed_ && items_.empty() && bulk_.empty()) changed_.Wait(lock);
    if (closed_) return std::nullopt;
    writes_bulk_ = items_.empty();
    std::deque<T>& from = writes_bulk_ ? bulk_ : items_;
    std::optional<T> item(std::move(from.front()));
    from.pop_front();
    return item;
  }
  // The item that Pop gave is written. True if it was bulk, and none is left.
  bool Written() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return std::exchange(writes_bulk_, false) && bulk_.empty();
  }

  // Items of bulk that wait or are being written.
  size_t bulk_unwritten() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return bulk_.size() + (writes_bulk_ ? 1 : 0);
  }
  // Those that wait.
  std::vector<T> RecallBulk() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    std::vector<T> taken(std::make_move_iterator(bulk_.begin()),
                         std::make_move_iterator(bulk_.end()));
    bulk_.clear();
    return taken;
  }

  void Close() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    closed_ = true;
    changed_.NotifyAll();
  }

 private:
  bool PushTo(std::deque<T>& to, T item) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    if (closed_ || to.size() >= capacity_) return false;
    to.push_back(std::move(item));
    changed_.NotifyOne();
    return true;
  }

  const size_t capacity_;
  mutable Mutex mu_;
  CondVar changed_;
  std::deque<T> items_ ABSL_GUARDED_BY(mu_);
  std::deque<T> bulk_ ABSL_GUARDED_BY(mu_);
  bool writes_bulk_ ABSL_GUARDED_BY(mu_) = false;
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_OUTGOING_QUEUE_H_
