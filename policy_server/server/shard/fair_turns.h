// How robots share one thread: turns by the time they used, and what a piece of work cost. Pure:
// times are arguments.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_FAIR_TURNS_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_FAIR_TURNS_H_

#include <algorithm>
#include <cstdint>
#include <functional>
#include <optional>
#include <utility>

#include "absl/container/btree_map.h"
#include "absl/container/flat_hash_map.h"
#include "services/base/clock.h"

namespace rips::pipeline {

// Start-time fair queueing: the next turn belongs to the waiting member that has used the least
// time. A member that was idle keeps no claim to the time it did not use, and one that used much
// time alone keeps no debt: both start level with the member served last. So a member that becomes
// ready waits for at most one turn of each member that is not ahead of it.
// Not thread-safe. `Key` is cheap to copy and has a hash.
template <typename Key>
class FairTurns {
 public:
  // `who` waits for its turn; no effect if it does already.
  void Ready(const Key& who) {
    Member& member = members_[who];
    if (member.place) return;
    member.used_ns = std::max(member.used_ns, served_ns_);
    member.place = Place{member.used_ns, ++arrivals_};
    waiting_.emplace(*member.place, who);
  }
  // Ends the wait of the member whose turn it is; nullopt if none waits.
  std::optional<Key> Next() {
    if (waiting_.empty()) return std::nullopt;
    const auto first = waiting_.begin();
    const Key who = first->second;
    served_ns_ = std::max(served_ns_, first->first.first);
    members_[who].place.reset();
    waiting_.erase(first);
    return who;
  }
  // `who` used so much time; it does not wait now.
  void Charge(const Key& who, int64_t ns) { members_[who].used_ns += ns; }
  // `who` has left.
  void Forget(const Key& who) {
    const auto it = members_.find(who);
    if (it == members_.end()) return;
    if (it->second.place) waiting_.erase(*it->second.place);
    members_.erase(it);
  }
  bool empty() const { return waiting_.empty(); }

 private:
  // Time used, then order of arrival.
  using Place = std::pair<int64_t, uint64_t>;
  struct Member {
    int64_t used_ns = 0;
    // In waiting_; nullopt = it does not wait.
    std::optional<Place> place;
  };
  absl::flat_hash_map<Key, Member> members_;
  absl::btree_map<Place, Key> waiting_;
  int64_t served_ns_ = 0;
  uint64_t arrivals_ = 0;
};

// The CPU time of pieces of work of one thread. Reading a thread's CPU clock is a system call, so
// work that lasted less than kExactNs costs what it lasted. One thread.
class CostMeter {
 public:
  static constexpr int64_t kExactNs = 100'000;

  // `cpu_ns`: CPU time of the calling thread.
  explicit CostMeter(std::function<int64_t()> cpu_ns) : cpu_ns_(std::move(cpu_ns)) {}

  // No work is under way; what the thread used for itself is charged to none.
  void Sync() {
    read_ns_ = cpu_ns_();
    unread_ns_ = 0;
  }
  // Of work that has just ended and lasted `wall_ns`.
  int64_t Cost(int64_t wall_ns) {
    if (wall_ns < kExactNs) {
      unread_ns_ += wall_ns;
      return wall_ns;
    }
    const int64_t now_ns = cpu_ns_();
    const int64_t used_ns = now_ns - read_ns_ - unread_ns_;
    read_ns_ = now_ns;
    unread_ns_ = 0;
    return std::clamp<int64_t>(used_ns, 0, wall_ns);
  }

 private:
  const std::function<int64_t()> cpu_ns_;
  int64_t read_ns_ = 0;
  // Charged since read_ns_.
  int64_t unread_ns_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_FAIR_TURNS_H_
