// How much processor time what an agent sends may take to be read: to be parsed, decoded and passed
// on, whatever comes of it. The threads of gRPC read all agents, so a message that is dear to read
// costs the others.
//
//   a stream                                            is read
//   that the robot has not admitted as a session        one message, its hello; then when it is
//                                                       admitted, or at a look of SessionWatch
//   of a session, and the agent's sessions have taken   no more, until a look of SessionWatch
//   more than `per_second_ns` a second, and `burst_ns`  finds that paid back; what it sends waits
//   at once                                             in the network. News each `again_ns`
//
// Streams that are not admitted are not charged: who has a copy of an agent's key could make its
// session pause. Times are arguments.
#ifndef RIPS_SERVICES_RPC_READING_PACE_H_
#define RIPS_SERVICES_RPC_READING_PACE_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/container/flat_hash_map.h"
#include "services/base/clock.h"
#include "services/base/cpu_budget.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

struct ReadingLimits {
  int64_t per_second_ns = 100 * kNanosPerMilli;
  int64_t burst_ns = 500 * kNanosPerMilli;
  int64_t again_ns = 600 * kNanosPerSecond;
};

// What a message takes to be read: measured by the CPU clock of its thread, or, if it is short and
// that system call would be a large part of it, by what time passes, but no more than its bytes can
// cost. What gRPC, TLS and the kernel took before is estimated. One thread.
class ReadingCost {
 public:
  explicit ReadingCost(size_t bytes);
  // Since then, in nanoseconds.
  int64_t Take() const;

 private:
  static constexpr size_t kShortBytes = 16 << 10;
  static constexpr int64_t kByteNs = 100;
  static constexpr int64_t kMessageNs = 20'000;
  // Before it is here.
  static constexpr int64_t kTransportNs = 5'000;
  static constexpr size_t kTransportBytesPerNs = 4;

  const size_t bytes_;
  const int64_t began_ns_;
};

// Of one agent. Any thread; times are CLOCK_BOOTTIME.
class ReadingPace {
 public:
  enum class Next {
    kRead,
    kPause,
    kPauseIsNews,  // and was none for `again_ns`
  };

  ReadingPace(const ReadingLimits& limits, int64_t now_ns)
      : limits_(limits), budget_(limits.per_second_ns, limits.burst_ns, now_ns), last_ns_(now_ns) {}

  // A message took so long to be read.
  Next OnRead(int64_t took_ns, int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  // Whether a stream that pauses may be read again.
  bool MayRead(int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  // Nothing that it did counts any more.
  bool Forgotten(int64_t now_ns) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  const ReadingLimits limits_;
  mutable Mutex mu_;
  CpuBudget budget_ ABSL_GUARDED_BY(mu_);
  // Of its newest message.
  int64_t last_ns_ ABSL_GUARDED_BY(mu_);
  // When a pause was news last.
  std::optional<int64_t> news_ns_ ABSL_GUARDED_BY(mu_);
};

// Of all agents. Any thread.
class ReadingPaces {
 public:
  explicit ReadingPaces(const ReadingLimits& limits = {}) : limits_(limits) {}

  // A stream that comes back finds what the one before has used. `peer`: its identity, so that a
  // renewed certificate is no new one.
  std::shared_ptr<ReadingPace> Of(const std::string& peer, int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  // Call it from time to time: drops those that nothing is to be known of.
  void Prune(int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  size_t size() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  const ReadingLimits limits_;
  mutable Mutex mu_;
  absl::flat_hash_map<std::string, std::shared_ptr<ReadingPace>> paces_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_READING_PACE_H_
