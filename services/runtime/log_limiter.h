// Keeps one source of lines (a robot, a kind of message on its bus) from filling the log: a burst
// of lines and then so many a second each; lines left out are counted; the next line has the count.
#ifndef RIPS_SERVICES_RUNTIME_LOG_LIMITER_H_
#define RIPS_SERVICES_RUNTIME_LOG_LIMITER_H_

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "services/runtime/mutex.h"

namespace rips {

// Any thread. Sources are few and trusted names, such as robots of valid certificates; beyond
// kSourcesMax all others share one place.
class LogLimiter {
 public:
  static constexpr double kBurst = 50;
  static constexpr double kPerSecond = 1;
  static constexpr size_t kSourcesMax = 4'096;

  explicit LogLimiter(double burst = kBurst, double per_second = kPerSecond)
      : burst_(burst), per_second_(per_second) {}

  // Lines of this source left out since the last one that was written; nullopt: leave this one out.
  std::optional<uint64_t> Admit(const std::string& source) ABSL_LOCKS_EXCLUDED(mu_) {
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    return Admit(source, std::chrono::duration<double>(now).count());
  }
  // The same at a given time, seconds.
  std::optional<uint64_t> Admit(const std::string& source, double now_s) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    const bool known = sources_.contains(source) || sources_.size() < kSourcesMax;
    Bucket& bucket =
        sources_.try_emplace(known ? source : "", Bucket{burst_, now_s, 0}).first->second;
    bucket.tokens = std::min(burst_, bucket.tokens + (now_s - bucket.refilled_s) * per_second_);
    bucket.refilled_s = now_s;
    if (bucket.tokens < 1) {
      ++bucket.left_out;
      return std::nullopt;
    }
    bucket.tokens -= 1;
    return std::exchange(bucket.left_out, 0);
  }

  // How many lines of this source were left out since the last one that was written; none are then.
  uint64_t TakeLeftOut(const std::string& source) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    auto it = sources_.find(source);
    if (it == sources_.end()) it = sources_.find("");
    return it == sources_.end() ? 0 : std::exchange(it->second.left_out, 0);
  }

 private:
  struct Bucket {
    double tokens = 0;
    double refilled_s = 0;
    uint64_t left_out = 0;
  };
  const double burst_;
  const double per_second_;
  Mutex mu_;
  absl::btree_map<std::string, Bucket> sources_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_LOG_LIMITER_H_
