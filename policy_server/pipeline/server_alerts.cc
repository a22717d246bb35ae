#include "policy_server/pipeline/server_alerts.h"

#include <utility>

#include "policy_server/pipeline/robot_config.h"

namespace rips::pipeline {

void ServerAlerts::Raise(const std::string& robot, engine::Severity severity,
                         const std::string& text, const std::string& level) {
  store::AlertRecord alert{.id = new_id_(),
                           .time_unix_ns = clock_->Now().unix_ns,
                           .robot = robot,
                           .rule = std::string(kOwnRule),
                           .severity = std::string(engine::ToString(severity)),
                           .text = text,
                           .level = level};
  store::WriteBatch batch;
  batch.alerts.push_back(alert);
  committer_->PutFirst(std::move(batch), [audience = audience_,
                                          alert = std::move(alert)](const absl::Status& status) {
    if (status.ok()) audience->OnAlert(alert);
  });
}

}  // namespace rips::pipeline
