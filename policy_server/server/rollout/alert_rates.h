// Counts alerts of rules, robot by robot, for the roll-out that watches them, on their way to those
// who watch alerts.
#ifndef RIPS_POLICY_SERVER_SERVER_ROLLOUT_ALERT_RATES_H_
#define RIPS_POLICY_SERVER_SERVER_ROLLOUT_ALERT_RATES_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/container/flat_hash_map.h"
#include "policy_server/server/robot/ports.h"
#include "policy_server/server/rollout/rollout.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::rollout {

// Any thread.
class AlertRates final : public pipeline::RobotObserver {
 public:
  // Of one robot within a minute; more are counted as so many.
  static constexpr size_t kCountMax = kAlertsPerMinuteMax + 1;

  // Neither is owned; both outlive this.
  AlertRates(pipeline::RobotObserver* next, const Clock* clock) : next_(next), clock_(clock) {}

  // From now on, and from zero.
  void Watch(const std::string& robot) ABSL_LOCKS_EXCLUDED(mu_);
  // No robot is watched any more.
  void Clear() ABSL_LOCKS_EXCLUDED(mu_);
  // Alerts of rules, of severity medium or above, within the last minute; 0 if it is not watched.
  uint32_t Count(const std::string& robot) ABSL_LOCKS_EXCLUDED(mu_);

  void OnAlert(const store::AlertRecord& alert) override ABSL_LOCKS_EXCLUDED(mu_);
  void OnNotice(const std::string& text) override { next_->OnNotice(text); }
  void OnStatus(const pipeline::RobotStatus& status) override { next_->OnStatus(status); }
  void OnRuleLog(const std::string& robot, const std::string& rule,
                 const std::string& text) override {
    next_->OnRuleLog(robot, rule, text);
  }

 private:
  pipeline::RobotObserver* const next_;
  const Clock* const clock_;
  Mutex mu_;
  // By robot: when, CLOCK_BOOTTIME, oldest first.
  absl::flat_hash_map<std::string, std::deque<int64_t>> times_ns_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::rollout

#endif  // RIPS_POLICY_SERVER_SERVER_ROLLOUT_ALERT_RATES_H_
