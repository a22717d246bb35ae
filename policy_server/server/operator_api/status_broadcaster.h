// Those who watch: alerts (through the feed, in the order of the store) and robot states, from the
// pipeline to the alert file and to operators' streams.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_STATUS_BROADCASTER_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_STATUS_BROADCASTER_H_

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "policy_server/server/operator_api/alert_feed.h"
#include "policy_server/server/robot/ports.h"
#include "policy_server/server/store/alert_log.h"
#include "services/runtime/log_limiter.h"
#include "services/runtime/mutex.h"

namespace rips::operator_api {

// Any thread.
class StatusBroadcaster final : public pipeline::RobotObserver {
 public:
  // Operator streams at one time, of both kinds together; one more is refused.
  static constexpr size_t kWatchersMax = 256;

  // Must not block. False = no longer interested, as Unwatch.
  using StatusWatcher = std::function<bool(const pipeline::RobotStatus&)>;

  // `alerts` may be null (no file). Not owned; both outlive this. `interval` as AlertFeed's.
  StatusBroadcaster(store::Store* store, store::AlertLog* alerts, FeedCounts counts = {},
                    absl::Duration interval = absl::Seconds(1));

  // An id for Unwatch. ResourceExhausted if there are kWatchersMax already. `after` as
  // AlertFeed::Watch.
  absl::StatusOr<uint64_t> WatchAlerts(std::optional<Cursor> after, AlertWatcher watcher)
      ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<uint64_t> WatchStatus(StatusWatcher watcher) ABSL_LOCKS_EXCLUDED(mu_);
  // The watcher may still be told what is being told now. An id that is gone does nothing.
  void Unwatch(uint64_t id) ABSL_LOCKS_EXCLUDED(mu_);

  // To the log, too, if it is RIPS's own and grave: a lost agent, an attack.
  void OnAlert(const store::AlertRecord& alert) override;
  void OnNotice(const std::string& text) override { feed_.Notify(text); }
  void OnStatus(const pipeline::RobotStatus& status) override ABSL_LOCKS_EXCLUDED(mu_);
  AlertFeed& feed() { return feed_; }
  // To the log, so many lines a robot.
  void OnRuleLog(const std::string& robot, const std::string& rule,
                 const std::string& text) override;

 private:
  // ResourceExhausted if there are kWatchersMax already.
  absl::StatusOr<uint64_t> NewIdLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const std::function<void()> cut_traces_;
  LogLimiter rule_logs_;
  LogLimiter alert_logs_;
  Mutex mu_;
  uint64_t next_id_ ABSL_GUARDED_BY(mu_) = 1;
  std::set<uint64_t> alert_watchers_ ABSL_GUARDED_BY(mu_);
  std::map<uint64_t, std::shared_ptr<StatusWatcher>> status_watchers_ ABSL_GUARDED_BY(mu_);
  // Last: its thread calls the others.
  AlertFeed feed_;
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_STATUS_BROADCASTER_H_
