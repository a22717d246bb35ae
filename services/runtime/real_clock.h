// The clocks of this host.
#ifndef RIPS_SERVICES_RUNTIME_REAL_CLOCK_H_
#define RIPS_SERVICES_RUNTIME_REAL_CLOCK_H_

#include <cstdint>

#include "absl/time/time.h"
#include "services/base/clock.h"

namespace rips {

// CLOCK_BOOTTIME now, and `delay` from now, nanoseconds: deadlines for CondVar::WaitUntil.
// InfiniteDuration gives INT64_MAX.
int64_t BoottimeNow();
int64_t BoottimeAfter(absl::Duration delay);

// Any thread.
class RealClock final : public Clock {
 public:
  Instant Now() const override;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_REAL_CLOCK_H_
