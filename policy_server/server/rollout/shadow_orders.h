// Which bundles run muted beside those in force, as operators ordered it: durable, and begun anew
// when the server starts.
#ifndef RIPS_POLICY_SERVER_SERVER_ROLLOUT_SHADOW_ORDERS_H_
#define RIPS_POLICY_SERVER_SERVER_ROLLOUT_SHADOW_ORDERS_H_

#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/bundle/inventory.h"
#include "policy_server/server/rollout/activated_bundles.h"
#include "policy_server/server/rollout/bundle_library.h"
#include "policy_server/server/rollout/robot_selection.h"
#include "policy_server/server/shadow/shadows.h"
#include "policy_server/server/shard/pipeline.h"

namespace rips::rollout {

struct ShadowWish {
  // As BundleLibrary::Find; empty: ends the shadows of these robots.
  std::string bundle;
  RobotSelection robots;
  std::string operator_name;
  std::string reason;
};

struct ShadowAnswer {
  // Robots whose shadow began or ended.
  std::vector<std::string> changed;
  // `r7: has none`
  std::vector<std::string> left_out;
  // `r7: sends nothing now`
  std::vector<std::string> notes;
};

// One thread at a time.
class ShadowOrders {
 public:
  // A kept bundle, to run muted.
  using Load = std::function<absl::StatusOr<shadow::ShadowPolicy>(const KeptBundle&)>;

  // Nothing is owned; all outlive this.
  ShadowOrders(Activations* activations, const BundleLibrary* library, shadow::Shadows* shadows,
               pipeline::Pipeline* pipeline, Load load)
      : activations_(activations),
        library_(library),
        shadows_(shadows),
        pipeline_(pipeline),
        load_(std::move(load)) {}

  // As they were ordered before this start; one that cannot begin is logged.
  void Restore();
  // Begins or ends shadows of robots of the inventory. Errors are for the operator who asks.
  absl::StatusOr<ShadowAnswer> Set(const ShadowWish& wish, const bundle::Inventory& inventory);

 private:
  using Robots = std::vector<const bundle::InventoryRobot*>;
  absl::StatusOr<ShadowAnswer> End(const Robots& robots);
  absl::Status Begin(const std::string& robot, const ShadowOrder& order,
                     const shadow::ShadowPolicy& policy);

  Activations* const activations_;
  const BundleLibrary* const library_;
  shadow::Shadows* const shadows_;
  pipeline::Pipeline* const pipeline_;
  const Load load_;
};

}  // namespace rips::rollout

#endif  // RIPS_POLICY_SERVER_SERVER_ROLLOUT_SHADOW_ORDERS_H_
