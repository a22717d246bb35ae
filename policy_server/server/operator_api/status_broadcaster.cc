#include "policy_server/server/operator_api/status_broadcaster.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/model/robot_config.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::operator_api {

absl::StatusOr<uint64_t> StatusBroadcaster::NewIdLocked() {
  if (alert_watchers_.size() + status_watchers_.size() >= kWatchersMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat(kWatchersMax, " operators watch already, the limit; try again later"));
  }
  return next_id_++;
}

StatusBroadcaster::StatusBroadcaster(store::Store* store, store::AlertLog* alerts,
                                     FeedCounts counts, absl::Duration interval)
    : cut_traces_(counts.cut_traces), feed_(store, alerts, std::move(counts), interval) {
  feed_.set_on_left([this](uint64_t id) { Unwatch(id); });
}

absl::StatusOr<uint64_t> StatusBroadcaster::WatchAlerts(std::optional<Cursor> after,
                                                        AlertWatcher watcher) {
  uint64_t id = 0;
  {
    MutexLock lock(&mu_);
    RIPS_ASSIGN_OR_RETURN(id, NewIdLocked());
    alert_watchers_.insert(id);
  }
  feed_.Watch(id, std::move(after), std::move(watcher));
  return id;
}

absl::StatusOr<uint64_t> StatusBroadcaster::WatchStatus(StatusWatcher watcher) {
  MutexLock lock(&mu_);
  RIPS_ASSIGN_OR_RETURN(const uint64_t id, NewIdLocked());
  status_watchers_[id] = std::make_shared<StatusWatcher>(std::move(watcher));
  return id;
}

void StatusBroadcaster::Unwatch(uint64_t id) {
  feed_.Unwatch(id);
  MutexLock lock(&mu_);
  alert_watchers_.erase(id);
  status_watchers_.erase(id);
}

void StatusBroadcaster::OnAlert(const store::AlertRecord& alert) {
  if (alert.trace.cut && cut_traces_) cut_traces_();
  feed_.Wake();
  if (alert.rule != pipeline::kOwnRule) return;
  if (alert.severity != "high" && alert.severity != "critical") return;
  const auto left_out = alert_logs_.Admit(alert.robot);
  if (!left_out.has_value()) return;
  LogWarning("alert", {{"robot", alert.robot},
                       {"severity", alert.severity},
                       {"id", alert.id},
                       {"text", alert.text},
                       {"left_out", *left_out}});
}

void StatusBroadcaster::OnStatus(const pipeline::RobotStatus& status) {
  std::map<uint64_t, std::shared_ptr<StatusWatcher>> watchers;
  {
    MutexLock lock(&mu_);
    watchers = status_watchers_;
  }
  for (const auto& [id, watcher] : watchers) {
    if (!(*watcher)(status)) Unwatch(id);
  }
}

void StatusBroadcaster::OnRuleLog(const std::string& robot, const std::string& rule,
                                  const std::string& text) {
  const auto admitted = rule_logs_.Admit(robot);
  if (!admitted.has_value()) return;
  LogInfo("a rule shows",
          {{"robot", robot}, {"rule", rule}, {"text", text}, {"left_out", *admitted}});
}

}  // namespace rips::operator_api
