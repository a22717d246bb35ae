#include "policy_server/server/rollout/alert_rates.h"

#include "policy_server/server/robot/model/robot_config.h"

namespace rips::rollout {
namespace {

constexpr int64_t kMinuteNs = 60 * kNanosPerSecond;

bool Counts(const store::AlertRecord& alert) {
  return alert.rule != pipeline::kOwnRule && alert.severity != "info" && alert.severity != "low";
}

}  // namespace

void AlertRates::Watch(const std::string& robot) {
  MutexLock lock(&mu_);
  times_ns_[robot].clear();
}

void AlertRates::Clear() {
  MutexLock lock(&mu_);
  times_ns_.clear();
}

uint32_t AlertRates::Count(const std::string& robot) {
  const int64_t since_ns = clock_->Now().boottime_ns - kMinuteNs;
  MutexLock lock(&mu_);
  const auto found = times_ns_.find(robot);
  if (found == times_ns_.end()) return 0;
  std::deque<int64_t>& times_ns = found->second;
  while (!times_ns.empty() && times_ns.front() <= since_ns) times_ns.pop_front();
  return static_cast<uint32_t>(times_ns.size());
}

void AlertRates::OnAlert(const store::AlertRecord& alert) {
  next_->OnAlert(alert);
  if (!Counts(alert)) return;
  const int64_t now_ns = clock_->Now().boottime_ns;
  MutexLock lock(&mu_);
  const auto found = times_ns_.find(alert.robot);
  if (found == times_ns_.end()) return;
  found->second.push_back(now_ns);
  if (found->second.size() > kCountMax) found->second.pop_front();
}

}  // namespace rips::rollout
