#include "policy_server/server/rollout/shadow_orders.h"

#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::rollout {

absl::Status ShadowOrders::Begin(const std::string& robot, const ShadowOrder& order,
                                 const shadow::ShadowPolicy& policy) {
  shadows_->End(robot);
  return shadows_->Begin(
      robot, {.policy = policy, .operator_name = order.operator_name, .reason = order.reason},
      [this, &robot](std::shared_ptr<pipeline::ShadowRecorder> tap,
                     std::shared_ptr<const pipeline::AlsoWatched> also) {
        return pipeline_->Post(robot, pipeline::Queue::kOrders,
                               [tap = std::move(tap), also = std::move(also)](
                                   pipeline::Robot& each) { each.SetShadow(tap, also); });
      });
}

void ShadowOrders::Restore() {
  for (const auto& [robot, order] : activations_->now().shadows) {
    absl::Status begun;
    if (const absl::StatusOr<KeptBundle> kept = library_->Find(order.bundle_id); !kept.ok()) {
      begun = kept.status();
    } else if (const auto policy = load_(*kept); !policy.ok()) {
      begun = policy.status();
    } else {
      begun = Begin(robot, order, *policy);
    }
    if (begun.ok()) continue;
    LogWarning("a shadow does not begin again",
               {{"robot", robot}, {"bundle", order.bundle_id}, {"reason", begun.message()}});
  }
}

absl::StatusOr<ShadowAnswer> ShadowOrders::End(const Robots& robots) {
  ShadowAnswer answer;
  ActivatedBundles next = activations_->now();
  for (const bundle::InventoryRobot* robot : robots) {
    const bool ordered = next.shadows.erase(robot->id) > 0;
    if (ordered || shadows_->Report(robot->id, false).has_value()) {
      answer.changed.push_back(robot->id);
    } else {
      answer.left_out.push_back(absl::StrCat(robot->id, ": has no shadow"));
    }
  }
  RIPS_RETURN_IF_ERROR(activations_->Set(std::move(next)));
  for (const std::string& robot : answer.changed) shadows_->End(robot);
  return answer;
}

absl::StatusOr<ShadowAnswer> ShadowOrders::Set(const ShadowWish& wish,
                                               const bundle::Inventory& inventory) {
  if (wish.bundle.empty()) {
    RIPS_ASSIGN_OR_RETURN(const Robots robots, Select(inventory, wish.robots, std::nullopt));
    return End(robots);
  }
  RIPS_ASSIGN_OR_RETURN(const KeptBundle kept, library_->Find(wish.bundle));
  if (!kept.problem.empty()) {
    return absl::FailedPreconditionError(absl::StrCat(kept.id, ": ", kept.problem));
  }
  RIPS_ASSIGN_OR_RETURN(const Robots robots, Select(inventory, wish.robots, kept.name));
  RIPS_ASSIGN_OR_RETURN(const shadow::ShadowPolicy policy, load_(kept));
  const ShadowOrder order{
      .bundle_id = kept.id, .operator_name = wish.operator_name, .reason = wish.reason};
  ActivatedBundles next = activations_->now();
  for (const bundle::InventoryRobot* robot : robots) next.shadows[robot->id] = order;
  RIPS_RETURN_IF_ERROR(activations_->Set(next));
  ShadowAnswer answer;
  for (const bundle::InventoryRobot* robot : robots) {
    const absl::Status begun = Begin(robot->id, order, policy);
    if (begun.ok()) {
      answer.changed.push_back(robot->id);
      continue;
    }
    answer.left_out.push_back(absl::StrCat(robot->id, ": ", begun.message()));
    next.shadows.erase(robot->id);
  }
  if (!answer.left_out.empty()) RIPS_RETURN_IF_ERROR(activations_->Set(std::move(next)));
  return answer;
}

}  // namespace rips::rollout
