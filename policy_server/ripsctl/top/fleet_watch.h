// The stream of a fleet's statuses, on a thread of its own.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_TOP_FLEET_WATCH_H_
#define RIPS_POLICY_SERVER_RIPSCTL_TOP_FLEET_WATCH_H_

#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "grpcpp/client_context.h"
#include "grpcpp/support/status.h"
#include "policy_server/ripsctl/cli/env.h"
#include "policy_server/ripsctl/top/fleet_view.h"
#include "services/runtime/mutex.h"
#include "services/runtime/wake_fd.h"

namespace rips::ripsctl {

// Keeps a FleetView up to date, reconnecting when needed, until it is destroyed. Of each bundle it
// asks one robot for the order of levels; without an answer the bundle's levels have no order.
class FleetWatch {
 public:
  // `env` is not owned and outlives this. Without robots: all.
  FleetWatch(Env* env, std::vector<std::string> robots);
  // Ends the stream.
  ~FleetWatch() ABSL_LOCKS_EXCLUDED(mu_);
  FleetWatch(const FleetWatch&) = delete;
  FleetWatch& operator=(const FleetWatch&) = delete;

  // Readable when something has changed. Drain it before Render.
  const WakeFd& changed() const { return changed_; }
  std::vector<ScreenLine> Render(TerminalSize size, absl::Time now) const ABSL_LOCKS_EXCLUDED(mu_);
  // How the watch ended: as KeepWatching says. None while it goes on.
  std::optional<absl::Status> ended() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  grpc::Status WatchOnce(bool again, const std::function<void()>& heard) ABSL_LOCKS_EXCLUDED(mu_);
  // A call that the destructor cancels begins, and ends. False if the watch is to end.
  bool Begin(grpc::ClientContext* context) ABSL_LOCKS_EXCLUDED(mu_);
  void End(grpc::ClientContext* context) ABSL_LOCKS_EXCLUDED(mu_);
  // False if it is too much.
  bool Received(const v1::RobotStatus& status) ABSL_LOCKS_EXCLUDED(mu_);
  void LearnLevels(const v1::RobotStatus& status) ABSL_LOCKS_EXCLUDED(mu_);
  // False if the watch is to end.
  bool Pause(absl::Duration duration) ABSL_LOCKS_EXCLUDED(mu_);

  Env* const env_;
  const std::vector<std::string> robots_;
  const WakeFd changed_;
  // By bundle: when it may be asked for again. Of the watch's thread.
  std::map<std::string, absl::Time> ask_levels_at_;
  mutable Mutex mu_;
  CondVar stop_cond_;
  bool stopped_ ABSL_GUARDED_BY(mu_) = false;
  FleetView view_ ABSL_GUARDED_BY(mu_);
  // Of the calls that run.
  std::set<grpc::ClientContext*> calls_ ABSL_GUARDED_BY(mu_);
  std::optional<absl::Status> ended_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_TOP_FLEET_WATCH_H_
