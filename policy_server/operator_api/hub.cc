#include "policy_server/operator_api/hub.h"

#include <utility>
#include <vector>

#include "services/runtime/log.h"

namespace rips::operator_api {

bool Hub::WatchAlerts(AlertWatcher watcher) {
  MutexLock lock(&mu_);
  if (alert_watchers_.size() + status_watchers_.size() >= kWatchersMax) return false;
  alert_watchers_[next_id_++] = std::make_shared<AlertWatcher>(std::move(watcher));
  return true;
}

bool Hub::WatchStatus(StatusWatcher watcher) {
  MutexLock lock(&mu_);
  if (alert_watchers_.size() + status_watchers_.size() >= kWatchersMax) return false;
  status_watchers_[next_id_++] = std::make_shared<StatusWatcher>(std::move(watcher));
  return true;
}

template <typename Watcher, typename Item>
void Hub::Tell(std::map<uint64_t, std::shared_ptr<Watcher>>& watchers, const Item& item) {
  std::vector<std::pair<uint64_t, std::shared_ptr<Watcher>>> copy;
  {
    MutexLock lock(&mu_);
    copy.assign(watchers.begin(), watchers.end());
  }
  // Called without the lock: a watcher may call back.
  std::vector<uint64_t> gone;
  for (const auto& [id, watcher] : copy) {
    if (!(*watcher)(item)) gone.push_back(id);
  }
  if (gone.empty()) return;
  MutexLock lock(&mu_);
  for (const uint64_t id : gone) watchers.erase(id);
}

void Hub::OnAlert(const store::AlertRecord& alert) {
  if (alert_log_ != nullptr) {
    if (const absl::Status status = alert_log_->Append({&alert, 1}); !status.ok()) {
      LogError("alert file not written", {{"alert", alert.id}, {"reason", status.message()}});
    }
  }
  Tell(alert_watchers_, alert);
}

void Hub::OnStatus(const pipeline::RobotStatus& status) { Tell(status_watchers_, status); }

}  // namespace rips::operator_api
