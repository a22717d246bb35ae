// How much processor time what a peer sends may take to be read: to be parsed, decoded and passed
// on, whatever comes of it. The threads of gRPC read all peers, so a message that is dear to read
// costs the others.
//
//   the messages of one peer, on all its streams                    its streams
//   have taken more than `per_second_ns` a second, and `burst_ns`   are not read until the next look
//   at once                                                         of SessionWatch after that; what
//                                                                   it sends waits in the network
//   take that again after `again_ns`                                the same, and it is news again
//
// A message costs the time that passes, since a thread's CPU clock is dear to ask, but at most what
// its bytes can cost: a thread may be kept from its work. Pure: times are arguments.
#ifndef RIPS_SERVICES_RPC_READING_PACE_H_
#define RIPS_SERVICES_RPC_READING_PACE_H_

#include <cstddef>
#include <cstdint>
#include <memory>
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
  // What a byte, and a message beside its bytes, can cost.
  int64_t byte_ns = 100;
  int64_t message_ns = 100'000;
  int64_t again_ns = 600 * kNanosPerSecond;
};

// Of one peer. Any thread; times are CLOCK_BOOTTIME.
class ReadingPace {
 public:
  enum class Next {
    kRead,
    kPause,
    kPauseIsNews,  // and was none for `again_ns`
  };

  ReadingPace(const ReadingLimits& limits, int64_t now_ns)
      : limits_(limits), budget_(limits.per_second_ns, limits.burst_ns, now_ns), last_ns_(now_ns) {}

  // A message of so many bytes was read in `took_ns`.
  Next OnRead(size_t bytes, int64_t took_ns, int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  // Whether streams that pause may read again.
  bool MayRead(int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  // Nothing that it did counts any more.
  bool Forgotten(int64_t now_ns) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  const ReadingLimits limits_;
  mutable Mutex mu_;
  CpuBudget budget_ ABSL_GUARDED_BY(mu_);
  // Of its newest message.
  int64_t last_ns_ ABSL_GUARDED_BY(mu_);
  // When a pause was news last; 0 = never.
  int64_t news_ns_ ABSL_GUARDED_BY(mu_) = 0;
};

// Of all peers. Any thread.
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
