// A clock that runs faster than the host's from the moment it is made.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_SCALED_CLOCK_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_SCALED_CLOCK_H_

#include <cstdint>

#include "services/base/clock.h"
#include "services/runtime/real_clock.h"

namespace rips::robot_sim {

// Any thread.
class ScaledClock final : public Clock {
 public:
  explicit ScaledClock(double speed) : speed_(speed), begun_(real_.Now()) {}

  Instant Now() const override {
    const Instant now = real_.Now();
    return {.boottime_ns = Scale(begun_.boottime_ns, now.boottime_ns),
            .unix_ns = Scale(begun_.unix_ns, now.unix_ns)};
  }

 private:
  int64_t Scale(int64_t begun_ns, int64_t now_ns) const {
    return begun_ns + static_cast<int64_t>(static_cast<double>(now_ns - begun_ns) * speed_);
  }

  const RealClock real_;
  const double speed_;
  const Instant begun_;
};

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_SCALED_CLOCK_H_
