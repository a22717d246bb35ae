// Counts what was refused for a field past its limit: rips_fields_refused_total{field}.
#ifndef RIPS_SERVICES_WIRE_LIMITS_LIMIT_COUNTERS_H_
#define RIPS_SERVICES_WIRE_LIMITS_LIMIT_COUNTERS_H_

#include <memory>
#include <vector>

#include "services/runtime/metrics.h"
#include "services/wire_limits/field_limits.h"

namespace rips::wire_limits {

// Copies count together; a default-made one counts nothing. Any thread; valid while its Metrics
// lives.
class LimitCounters {
 public:
  LimitCounters() = default;
  // One counter for each row that is a limit, so that the page has them all from the start.
  explicit LimitCounters(Metrics* metrics);

  void Count(const LimitHit& hit) const;

 private:
  std::shared_ptr<const std::vector<Counter>> by_row_;
};

}  // namespace rips::wire_limits

#endif  // RIPS_SERVICES_WIRE_LIMITS_LIMIT_COUNTERS_H_
