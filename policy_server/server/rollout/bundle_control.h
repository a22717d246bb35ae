// What operators order of bundles: to keep one, to run it muted beside the one in force, to have
// robots judged by it stage by stage, to go back. Wires the fleet, the durable activations, the
// library and the roll-out that runs, on one thread. An order is durable before any robot is judged
// by it, so that a restart goes on from it.
#ifndef RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_CONTROL_H_
#define RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_CONTROL_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/fleet.h"
#include "policy_server/server/policy_source.h"
#include "policy_server/server/rollout/activated_bundles.h"
#include "policy_server/server/rollout/alert_rates.h"
#include "policy_server/server/rollout/bundle_library.h"
#include "policy_server/server/rollout/order_thread.h"
#include "policy_server/server/rollout/robot_selection.h"
#include "policy_server/server/rollout/rollout.h"
#include "policy_server/server/rollout/shadow_orders.h"
#include "policy_server/server/shadow/shadow_report.h"
#include "policy_server/server/shadow/shadows.h"
#include "policy_server/server/shard/pipeline.h"
#include "policy_server/server/shard/server_alerts.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::rollout {

struct ActivateOrder {
  // As BundleLibrary::Find, or kDirectory.
  std::string bundle;
  RobotSelection robots;
  std::vector<StageSelection> stages;
  // 0 = the default of each.
  int64_t soak_ns = 0;
  uint32_t alerts_per_minute_max = 0;
  bool roll_back_when_stopped = false;
  std::string operator_name;
  std::string reason;
  bool dry_run = false;
};

struct RollBackOrder {
  RobotSelection robots;
  std::string operator_name;
  std::string reason;
  bool dry_run = false;
};

// Stands for the bundle that the server's directory holds.
inline constexpr absl::string_view kDirectory = "directory";

struct RolloutAnswer {
  // The newest, or the one that would begin.
  std::optional<RolloutRecord> rollout;
  std::optional<int64_t> healthy_since_unix_ns;
  // Robots that are judged by something else from now on.
  std::vector<std::string> changed;
  // `r7: is judged by it already`
  std::vector<std::string> left_out;
  // What else the operator should know, `r7: will not take it: ...`
  std::vector<std::string> notes;
};

// By which bundle a robot is judged, and should be.
struct RobotRules {
  std::string robot;
  // Of its policy in the inventory.
  std::string name;
  // Empty = nothing judges it.
  std::string bundle_in_use;
  // Only if it counts.
  std::optional<Activation> activation;
  // Why it is not judged by what it should be; empty = it is.
  std::string problem;
  // Of what runs muted beside it; with examples only if the robot was asked for by name.
  std::optional<shadow::ShadowReport> shadow;
};

struct RulesStatus {
  // Sorted.
  std::vector<RobotRules> robots;
  std::optional<RolloutRecord> rollout;
  std::optional<int64_t> healthy_since_unix_ns;
  // Of the roll-out that runs: why its stage is not healthy.
  std::string not_healthy_because;
  // Robots that have not answered in time; sorted.
  std::vector<std::string> no_answer;
};

class BundleControl {
 public:
  struct Parts {
    server::Fleet* fleet = nullptr;
    Activations* activations = nullptr;
    BundleLibrary* library = nullptr;
    AlertRates* rates = nullptr;
    server::PolicySource* policies = nullptr;
    shadow::Shadows* shadows = nullptr;
    ShadowOrders::Load load_shadow;
    pipeline::Pipeline* pipeline = nullptr;
    pipeline::ServerAlerts* alerts = nullptr;
    const Clock* clock = nullptr;
    std::function<std::string()> new_id;
  };

  // After Fleet::Start. Nothing is owned; all outlive this. A roll-out that ran goes on, and
  // shadows begin anew.
  explicit BundleControl(Parts parts);

  // On which everything below runs, but for what any thread may ask, and Push: checking a bundle
  // may take long, and no order waits for it.
  OrderThread& thread() { return thread_; }
  OrderThread& pushes() { return pushes_; }
  void Start();
  // Ends both threads. Idempotent.
  void Stop();
  // Posts Fleet::Reload, after `before`, and waits for it. False: too many orders wait.
  bool Reload(std::function<void()> before);

  // ---- any thread that may wait
  absl::StatusOr<std::vector<KeptBundle>> List() const { return parts_.library->List(); }
  // Of one robot, or of all if `robot` is empty: what has been ordered, and what robots say to it
  // now. NotFound.
  absl::StatusOr<RulesStatus> Status(const std::string& robot) const ABSL_LOCKS_EXCLUDED(mu_);

  // ---- on the thread of pushes
  absl::StatusOr<BundleLibrary::Added> Push(absl::string_view archive);

  // ---- on the thread; errors are for the operator who asks.
  absl::StatusOr<RolloutAnswer> Activate(const ActivateOrder& order);
  absl::StatusOr<RolloutAnswer> RollBack(const RollBackOrder& order);
  // NotFound if none runs.
  absl::StatusOr<RolloutAnswer> StopRollout(const std::string& operator_name,
                                            const std::string& reason);
  absl::StatusOr<ShadowAnswer> Shadow(const ShadowWish& wish);
  // Looks at the roll-out that runs, if any.
  void Look();

 private:
  // What is to be rolled out.
  struct Chosen {
    std::string id;
    std::string name;
    bool from_directory = false;
    pipeline::Policy policy;
  };
  absl::StatusOr<Chosen> Choose(const ActivateOrder& order);
  // What of the robots speaks against the bundle, or is lost with it.
  std::vector<std::string> Forecast(const std::vector<const bundle::InventoryRobot*>& robots,
                                    const pipeline::Policy& policy) const;
  absl::StatusOr<RolloutAnswer> Begin(RolloutPlan plan, RolloutAnswer answer);
  // Makes durable what the step asks for, and does it. An error: nothing was done.
  absl::Status Perform(Rollout& rollout, RolloutStep step);
  // Says that the roll-out, which would be `next`, cannot go on.
  void OnUnrecorded(const RolloutRecord& next, const absl::Status& status);
  void Report(const RolloutRecord& record, const RolloutStep& step);
  FleetHealth Health() const;
  // Has Status answer from how it is now.
  void Publish() ABSL_LOCKS_EXCLUDED(mu_);
  RolloutAnswer Answer() const;

  const Parts parts_;
  ShadowOrders shadows_;
  std::optional<Rollout> rollout_;
  // Why its next step cannot be made durable; empty = it can.
  std::string unrecorded_;
  mutable Mutex mu_;
  // Without what robots say.
  std::shared_ptr<const RulesStatus> published_ ABSL_GUARDED_BY(mu_);
  // Last: they use the others.
  OrderThread thread_;
  OrderThread pushes_;
};

}  // namespace rips::rollout

#endif  // RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_CONTROL_H_
