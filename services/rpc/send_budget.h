// What several streams together may hold of messages that their peers have not read.
#ifndef RIPS_SERVICES_RPC_SEND_BUDGET_H_
#define RIPS_SERVICES_RPC_SEND_BUDGET_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

// When it is used up, the stream that holds most is ended, of the owner whose streams together hold
// most: a peer that reads does not pay for one that does not, however many streams that one has.
// What an ended stream still holds, one message that the library writes, counts apart; when that
// uses up as much again, the owners of such streams get no more. So all together hold at most twice
// `bytes_max`, and what peers hold that have no ended stream.
//
// Any thread. `evict` is called without a lock, on the thread that takes.
class SendBudget {
 public:
  explicit SendBudget(size_t bytes_max) : bytes_max_(bytes_max) {}

  // A stream of `owner` that holds nothing. `evict` ends it, and may be called after Leave.
  uint64_t Join(std::string owner, std::function<void()> evict) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    holders_[++last_] = {.owner = std::move(owner), .evict = std::move(evict)};
    return last_;
  }
  // It holds nothing any more.
  void Leave(uint64_t id) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    const auto holder = holders_.find(id);
    if (holder == holders_.end()) return;
    TotalOf(holder->second) -= holder->second.bytes;
    holders_.erase(holder);
  }

  // False if this one must be ended instead, and then nothing is taken.
  bool Reserve(uint64_t id, size_t bytes) ABSL_LOCKS_EXCLUDED(mu_) {
    while (true) {
      std::function<void()> evict;
      {
        MutexLock lock(&mu_);
        const auto taker = holders_.find(id);
        if (taker == holders_.end() || taker->second.evicted) return false;
        if (ending_bytes_ + bytes > bytes_max_ && HasEndedLocked(taker->second.owner)) {
          EvictLocked(taker->second);
          return false;
        }
        if (bytes <= bytes_max_ && bytes_ <= bytes_max_ - bytes) {
          bytes_ += bytes;
          taker->second.bytes += bytes;
          return true;
        }
        Holder& victim = ChooseLocked(id, bytes);
        EvictLocked(victim);
        if (&victim == &taker->second) return false;
        evict = victim.evict;
      }
      evict();
    }
  }
  void Release(uint64_t id, size_t bytes) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    const auto holder = holders_.find(id);
    if (holder == holders_.end()) return;
    holder->second.bytes -= bytes;
    TotalOf(holder->second) -= bytes;
  }

  // Those that are being ended included.
  size_t bytes() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return bytes_ + ending_bytes_;
  }
  size_t bytes_max() const { return bytes_max_; }

 private:
  struct Holder {
    std::string owner;
    std::function<void()> evict;
    size_t bytes = 0;
    // It is being ended.
    bool evicted = false;
  };

  size_t& TotalOf(const Holder& holder) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    return holder.evicted ? ending_bytes_ : bytes_;
  }
  void EvictLocked(Holder& holder) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    bytes_ -= holder.bytes;
    ending_bytes_ += holder.bytes;
    holder.evicted = true;
  }
  bool HasEndedLocked(const std::string& owner) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    for (const auto& [id, each] : holders_) {
      if (each.evicted && each.owner == owner) return true;
    }
    return false;
  }
  // Among those that are not being ended; the taker, with what it wants, is one of them.
  Holder& ChooseLocked(uint64_t taker, size_t wanted) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) {
    std::map<std::string, size_t> by_owner;
    const auto held = [&](uint64_t id, const Holder& each) {
      return each.bytes + (id == taker ? wanted : 0);
    };
    for (const auto& [id, each] : holders_) {
      if (!each.evicted) by_owner[each.owner] += held(id, each);
    }
    Holder* worst = &holders_.at(taker);
    std::pair<size_t, size_t> most = {by_owner[worst->owner], held(taker, *worst)};
    for (auto& [id, each] : holders_) {
      if (each.evicted) continue;
      const std::pair<size_t, size_t> its = {by_owner[each.owner], held(id, each)};
      if (its <= most) continue;
      most = its;
      worst = &each;
    }
    return *worst;
  }

  const size_t bytes_max_;
  mutable Mutex mu_;
  uint64_t last_ ABSL_GUARDED_BY(mu_) = 0;
  size_t bytes_ ABSL_GUARDED_BY(mu_) = 0;
  // Of streams that are being ended.
  size_t ending_bytes_ ABSL_GUARDED_BY(mu_) = 0;
  std::map<uint64_t, Holder> holders_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_SEND_BUDGET_H_
