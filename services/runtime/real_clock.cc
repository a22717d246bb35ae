#include "services/runtime/real_clock.h"

#include <time.h>

#include <limits>

namespace rips {
namespace {

int64_t Read(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return time.tv_sec * kNanosPerSecond + time.tv_nsec;
}

}  // namespace

int64_t BoottimeNow() { return Read(CLOCK_BOOTTIME); }

int64_t BoottimeAfter(absl::Duration delay) {
  const int64_t now_ns = BoottimeNow();
  const int64_t delay_ns = absl::ToInt64Nanoseconds(delay);  // saturates
  if (delay_ns > std::numeric_limits<int64_t>::max() - now_ns) {
    return std::numeric_limits<int64_t>::max();
  }
  return now_ns + delay_ns;
}

Instant RealClock::Now() const {
  return {.boottime_ns = BoottimeNow(), .unix_ns = Read(CLOCK_REALTIME)};
}

}  // namespace rips
