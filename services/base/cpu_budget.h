// How much processor time one of many may use. Header only, pure.
#ifndef RIPS_SERVICES_BASE_CPU_BUDGET_H_
#define RIPS_SERVICES_BASE_CPU_BUDGET_H_

#include <algorithm>
#include <cstdint>

#include "services/base/clock.h"

namespace rips {

// A token bucket of CPU time. Not thread-safe; times are CLOCK_BOOTTIME.
class CpuBudget {
 public:
  // `per_second_ns` flows in each second, `burst_ns` at most are saved.
  CpuBudget(int64_t per_second_ns, int64_t burst_ns, int64_t now_ns)
      : per_second_ns_(per_second_ns), burst_ns_(burst_ns), left_ns_(burst_ns), at_ns_(now_ns) {}

  void Charge(int64_t cost_ns) { left_ns_ -= cost_ns; }
  // Nothing is left at `now_ns`.
  bool Spent(int64_t now_ns) {
    if (now_ns > at_ns_) {
      const double inflow = static_cast<double>(now_ns - at_ns_) / kNanosPerSecond *
                            static_cast<double>(per_second_ns_);
      const double room = static_cast<double>(burst_ns_ - left_ns_);
      left_ns_ += static_cast<int64_t>(std::min(inflow, room));
      at_ns_ = now_ns;
    }
    return left_ns_ < 0;
  }

 private:
  const int64_t per_second_ns_;
  const int64_t burst_ns_;
  int64_t left_ns_;
  int64_t at_ns_;
};

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_CPU_BUDGET_H_
