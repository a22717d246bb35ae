// Where time comes from. Pure code takes time as an argument; shells take a Clock.
#ifndef RIPS_SERVICES_BASE_CLOCK_H_
#define RIPS_SERVICES_BASE_CLOCK_H_

#include <cstdint>

namespace rips {

// One instant, read from both clocks together.
struct Instant {
  // CLOCK_BOOTTIME, nanoseconds: never goes back, counts suspend; orders events and runs leases.
  // Comparable within one boot of one host only.
  int64_t boottime_ns = 0;
  // CLOCK_REALTIME, nanoseconds since the Unix epoch: for display; may jump.
  int64_t unix_ns = 0;

  friend bool operator==(const Instant&, const Instant&) = default;
};

inline constexpr int64_t kNanosPerMilli = 1'000'000;
inline constexpr int64_t kNanosPerSecond = 1'000'000'000;

// Implementations may be called from any thread.
class Clock {
 public:
  virtual ~Clock() = default;
  virtual Instant Now() const = 0;
};

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_CLOCK_H_
