// A Clock that tests set. Test code only; any thread.
#ifndef RIPS_SERVICES_BASE_FAKE_CLOCK_H_
#define RIPS_SERVICES_BASE_FAKE_CLOCK_H_

#include <atomic>

#include "services/base/clock.h"

namespace rips {

class FakeClock final : public Clock {
 public:
  // Starts at 1,000 s after boot, 2026-01-01T00:00:00Z.
  FakeClock() = default;

  Instant Now() const override {
    const int64_t passed_ns = passed_ns_.load();
    return {.boottime_ns = 1'000 * kNanosPerSecond + passed_ns,
            .unix_ns = 1'767'225'600 * kNanosPerSecond + passed_ns + unix_jump_ns_.load()};
  }
  void Advance(int64_t ns) { passed_ns_ += ns; }
  // Moves the wall clock only, as an administrator or NTP would.
  void JumpUnix(int64_t ns) { unix_jump_ns_ += ns; }

 private:
  std::atomic<int64_t> passed_ns_ = 0;
  std::atomic<int64_t> unix_jump_ns_ = 0;
};

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_FAKE_CLOCK_H_
