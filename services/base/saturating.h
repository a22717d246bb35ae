// Sums of counts that a peer chooses stop at the largest number instead of beginning anew at 0.
#ifndef RIPS_SERVICES_BASE_SATURATING_H_
#define RIPS_SERVICES_BASE_SATURATING_H_

#include <cstdint>
#include <limits>

namespace rips {

constexpr uint64_t SaturatingAdd(uint64_t a, uint64_t b) {
  constexpr uint64_t kMost = std::numeric_limits<uint64_t>::max();
  return a > kMost - b ? kMost : a + b;
}

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_SATURATING_H_
