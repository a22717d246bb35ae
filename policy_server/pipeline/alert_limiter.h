// Keeps a rule that fires on every message from drowning people: beyond 10 alerts a second (burst
// 100) per rule, alerts are folded into one summary a second with their count.
#ifndef RIPS_POLICY_SERVER_PIPELINE_ALERT_LIMITER_H_
#define RIPS_POLICY_SERVER_PIPELINE_ALERT_LIMITER_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "policy_server/engine/effect.h"
#include "services/base/clock.h"

namespace rips::pipeline {

struct AlertLimits {
  double per_second = 10;
  double burst = 100;
};

// One per robot. Not thread-safe.
class AlertLimiter {
 public:
  explicit AlertLimiter(AlertLimits limits = {}) : limits_(limits) {}

  // True if the alert may go out now; false if it was folded away.
  bool Admit(const engine::AlertEffect& alert, Instant now);
  // Summaries that are due: "N more like: TEXT", with the severity of the most severe.
  std::vector<engine::AlertEffect> Due(Instant now);

 private:
  struct Bucket {
    double tokens = 0;
    int64_t refilled_ns = 0;
    uint64_t folded = 0;
    int64_t folded_since_ns = 0;
    engine::AlertEffect last;
  };
  AlertLimits limits_;
  absl::btree_map<std::string, Bucket> buckets_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_PIPELINE_ALERT_LIMITER_H_
