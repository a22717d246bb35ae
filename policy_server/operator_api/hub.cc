#include "policy_server/operator_api/hub.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::operator_api {

absl::StatusOr<uint64_t> Hub::NewIdLocked() {
  if (alert_watchers_.size() + status_watchers_.size() >= kWatchersMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat(kWatchersMax, " operators watch already, the limit; try again later"));
  }
  return next_id_++;
}

absl::StatusOr<uint64_t> Hub::WatchAlerts(AlertWatcher watcher) {
  MutexLock lock(&mu_);
  RIPS_ASSIGN_OR_RETURN(const uint64_t id, NewIdLocked());
  alert_watchers_[id] = std::make_shared<AlertWatcher>(std::move(watcher));
  return id;
}

absl::StatusOr<uint64_t> Hub::WatchStatus(StatusWatcher watcher) {
  MutexLock lock(&mu_);
  RIPS_ASSIGN_OR_RETURN(const uint64_t id, NewIdLocked());
  status_watchers_[id] = std::make_shared<StatusWatcher>(std::move(watcher));
  return id;
}

void Hub::Unwatch(uint64_t id) {
  MutexLock lock(&mu_);
  alert_watchers_.erase(id);
  status_watchers_.erase(id);
}

void Hub::OnAlert(const store::AlertRecord& alert) {
  if (alert_log_ != nullptr) {
    if (const absl::Status status = alert_log_->Append({&alert, 1}); !status.ok()) {
      LogError("alert file not written", {{"alert", alert.id}, {"reason", status.message()}});
    }
  }
  std::map<uint64_t, std::shared_ptr<AlertWatcher>> watchers;
  {
    MutexLock lock(&mu_);
    watchers = alert_watchers_;
  }
  // Without the lock: a watcher may call back.
  for (const auto& [id, watcher] : watchers) {
    if (!(*watcher)(alert)) Unwatch(id);
  }
}

void Hub::OnStatus(const pipeline::RobotStatus& status) {
  std::map<uint64_t, std::shared_ptr<StatusWatcher>> watchers;
  {
    MutexLock lock(&mu_);
    watchers = status_watchers_;
  }
  for (const auto& [id, watcher] : watchers) {
    if (!(*watcher)(status)) Unwatch(id);
  }
}

void Hub::OnRuleLog(const std::string& robot, const std::string& rule, const std::string& text) {
  LogInfo("a rule shows", {{"robot", robot}, {"rule", rule}, {"text", text}});
}

}  // namespace rips::operator_api
