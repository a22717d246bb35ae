// Alerts that no robot of the pipeline can raise: of the server itself, and of robots that it does
// not judge. Kept until they are recorded, in an outage too, and told when they are.
//
// Limited as what a robot says by itself (kOwnAlertLimits), for each robot and each place in the
// code that raises one. The count of folded alerts comes with the next alert of any kind.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_SERVER_ALERTS_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_SERVER_ALERTS_H_

#include <functional>
#include <optional>
#include <source_location>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "policy_server/policy/engine/state/effect.h"
#include "policy_server/server/robot/context/alert_limiter.h"
#include "policy_server/server/robot/ports.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/maintenance.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {

// Any thread; never blocks on the disk.
class ServerAlerts {
 public:
  // Nothing is owned; all outlive what is raised.
  ServerAlerts(store::Committer* committer, RobotObserver* audience, const Clock* clock,
               std::function<std::string()> new_id)
      : committer_(committer), audience_(audience), clock_(clock), new_id_(std::move(new_id)) {}

  // `robot`: store::kServerRobot, or one of the inventory; `level` as recorded, may be empty.
  void Raise(const std::string& robot, engine::Severity severity, const std::string& text,
             const std::string& level = "",
             std::source_location where = std::source_location::current()) ABSL_LOCKS_EXCLUDED(mu_);
  // Alerts of the robot carry its mark until its end or another call; nullopt: it is in none.
  void SetMaintenance(const std::string& robot,
                      const std::optional<store::Maintenance>& maintenance)
      ABSL_LOCKS_EXCLUDED(mu_);
  // Tells those who watch at once, whether it can be recorded or not.
  void Announce(const std::string& text) { audience_->OnNotice(text); }

 private:
  void Put(const std::string& robot, const engine::AlertEffect& alert, const std::string& level);

  // As Alerts, of the robot's maintenance; empty = it is in none.
  std::string MarkOf(const std::string& robot) ABSL_LOCKS_EXCLUDED(mu_);

  store::Committer* committer_;
  RobotObserver* audience_;
  const Clock* clock_;
  std::function<std::string()> new_id_;
  Mutex mu_;
  // By robot, all of the inventory or kServerRobot.
  absl::btree_map<std::string, AlertLimiter> limiters_ ABSL_GUARDED_BY(mu_);
  // By robot, those that are in one.
  absl::btree_map<std::string, store::Maintenance> maintenance_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_SERVER_ALERTS_H_
