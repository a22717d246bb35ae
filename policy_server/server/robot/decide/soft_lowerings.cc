#include "policy_server/server/robot/decide/soft_lowerings.h"

#include <algorithm>
#include <limits>

namespace rips::pipeline {

std::vector<int64_t> SoftLowerings(const store::RobotRecord& record,
                                   const levels::LevelTable& table, Instant now) {
  std::vector<int64_t> lowered_at_ns;
  const int64_t now_unix_ns = std::max<int64_t>(now.unix_ns, 0);
  // None is older than those before it.
  int64_t age_ns = std::numeric_limits<int64_t>::max();
  for (const store::RuleDecision& decision : record.rule_decisions) {
    const int64_t recorded_ns = std::clamp<int64_t>(decision.time_unix_ns, 0, now_unix_ns);
    age_ns = std::min(age_ns, now_unix_ns - recorded_ns);
    const auto from = table.Find(decision.from);
    const auto to = table.Find(decision.to);
    if (from && to && *to >= *from) continue;
    lowered_at_ns.push_back(now.boottime_ns - age_ns);
  }
  return lowered_at_ns;
}

}  // namespace rips::pipeline
