#include "services/wire_limits/limit_counters.h"

#include <utility>

namespace rips::wire_limits {

LimitCounters::LimitCounters(Metrics* metrics) {
  std::vector<Counter> counters;
  for (const FieldLimit& limit : FieldLimits()) {
    const bool any = limit.value_max == kAnyValue && limit.elements_max == 1;
    counters.push_back(any ? Counter()
                           : metrics->AddCounter("rips_fields_refused_total",
                                                 "Messages refused for a field past its limit.",
                                                 {{"field", limit.field}}));
  }
  by_row_ = std::make_shared<const std::vector<Counter>>(std::move(counters));
}

void LimitCounters::Count(const LimitHit& hit) const {
  if (by_row_ != nullptr) (*by_row_)[hit.row].Increment();
}

}  // namespace rips::wire_limits
