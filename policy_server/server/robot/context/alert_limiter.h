// Keeps what fires on every message from drowning people and filling disks. Beyond a rate, alerts
// of one kind are folded into a summary with their count, the newest text and the highest severity:
//   a rule               10 a second, burst 100; a summary a second
//   a kind of RIPS's own  1 a minute, burst 20; a summary a minute
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ALERT_LIMITER_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ALERT_LIMITER_H_

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "policy_server/policy/engine/state/effect.h"
#include "services/base/clock.h"

namespace rips::pipeline {

struct AlertLimits {
  double per_second = 10;
  double burst = 100;
  int64_t summary_ns = kNanosPerSecond;
  // Of what there is one bucket each, for people, and how long that is.
  const char* kind = "rule";
  const char* within = "a second";
};

// For what RIPS says by itself: much of it can be caused by whoever holds a robot's key.
inline constexpr AlertLimits kOwnAlertLimits{.per_second = 1.0 / 60,
                                             .burst = 20,
                                             .summary_ns = 60 * kNanosPerSecond,
                                             .kind = "kind",
                                             .within = "a minute"};

// Alerts of one kind that were folded away.
struct FoldedAlerts {
  uint64_t count = 0;
  // CLOCK_BOOTTIME of the first and the last one, nanoseconds.
  int64_t first_ns = 0;
  int64_t last_ns = 0;
  // The first one, with the newest text and the highest severity.
  engine::AlertEffect alert;
};

// One per robot. Not thread-safe.
class AlertLimiter {
 public:
  explicit AlertLimiter(AlertLimits limits = {}) : limits_(limits) {}

  // True if the alert may go out now; false if it was folded away.
  bool Admit(const engine::AlertEffect& alert, Instant now) {
    return Admit(alert.rule, alert, now);
  }
  // The same with a kind of its own. `kind` is of a bounded set: each has its bucket for ever.
  bool Admit(const std::string& kind, const engine::AlertEffect& alert, Instant now);
  // Summaries that are due: "N more like: TEXT", with the severity of the most severe.
  std::vector<engine::AlertEffect> Due(Instant now);
  // What a summary that is due is made from, for a kind with words of its own: it is none of Due
  // then. nullopt: none is due.
  std::optional<FoldedAlerts> Pop(const std::string& kind, Instant now);

 private:
  struct Bucket {
    double tokens = 0;
    int64_t refilled_ns = 0;
    FoldedAlerts folded;
  };
  bool IsDue(const Bucket& bucket, Instant now) const;

  AlertLimits limits_;
  absl::btree_map<std::string, Bucket> buckets_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ALERT_LIMITER_H_
