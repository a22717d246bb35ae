#include "policy_server/server/shard/server_alerts.h"

#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/context/maintenance_window.h"
#include "policy_server/server/robot/model/robot_config.h"
#include "services/base/cut_text.h"

namespace rips::pipeline {

void ServerAlerts::Raise(const std::string& robot, engine::Severity severity,
                         const std::string& text, const std::string& level,
                         std::source_location where) {
  const engine::AlertEffect alert{.rule = std::string(kOwnRule),
                                  .severity = severity,
                                  .text = Shortened(text, kOwnAlertBytesMax)};
  const std::string kind = absl::StrCat(where.file_name(), ":", where.line());
  bool admitted = false;
  std::vector<engine::AlertEffect> summaries;
  {
    MutexLock lock(&mu_);
    const Instant now = clock_->Now();
    AlertLimiter& limiter = limiters_.try_emplace(robot, kOwnAlertLimits).first->second;
    summaries = limiter.Due(now);
    admitted = limiter.Admit(kind, alert, now);
  }
  for (const engine::AlertEffect& summary : summaries) Put(robot, summary, level);
  if (admitted) Put(robot, alert, level);
}

void ServerAlerts::SetMaintenance(const std::string& robot,
                                  const std::optional<store::Maintenance>& maintenance) {
  MutexLock lock(&mu_);
  if (maintenance) {
    maintenance_[robot] = *maintenance;
  } else {
    maintenance_.erase(robot);
  }
}

std::string ServerAlerts::MarkOf(const std::string& robot) {
  MutexLock lock(&mu_);
  const auto found = maintenance_.find(robot);
  // Of a robot that nothing judges any more no other status comes.
  if (found == maintenance_.end() || found->second.until_unix_ns <= clock_->Now().unix_ns) {
    return "";
  }
  return MaintenanceMark(found->second);
}

void ServerAlerts::Put(const std::string& robot, const engine::AlertEffect& effect,
                       const std::string& level) {
  store::AlertRecord alert{.id = new_id_(),
                           .time_unix_ns = clock_->Now().unix_ns,
                           .robot = robot,
                           .rule = effect.rule,
                           .severity = std::string(engine::ToString(effect.severity)),
                           .text = effect.text,
                           .level = level,
                           .maintenance = MarkOf(robot)};
  store::WriteBatch batch{.robot = robot};
  batch.alerts.push_back(alert);
  committer_->PutFirst(std::move(batch), [audience = audience_,
                                          alert = std::move(alert)](const absl::Status& status) {
    if (status.ok()) audience->OnAlert(alert);
  });
}

}  // namespace rips::pipeline
