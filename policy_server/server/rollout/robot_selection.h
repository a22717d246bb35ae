// Which robots an order about bundles is for, and in which stages. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROLLOUT_ROBOT_SELECTION_H_
#define RIPS_POLICY_SERVER_SERVER_ROLLOUT_ROBOT_SELECTION_H_

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/bundle/inventory.h"

namespace rips::rollout {

// Exactly one is given.
struct RobotSelection {
  std::vector<std::string> robots;
  // `KEY=VALUE`, all of them.
  std::vector<std::string> labels;
  bool all = false;
};

// The robots of a stage, besides those of the stages before it. Exactly one is given.
struct StageSelection {
  // `KEY=VALUE`
  std::string label;
  // Of the selection by name, rounded up; 1 to 100.
  uint32_t percent = 0;
};

// Robots of the inventory, sorted by name, never none. `name`: of the policy that they must have;
// nullopt = any. NotFound: no such robot; FailedPrecondition: a robot that is named has another
// policy; InvalidArgument: none or several of the selection's members are given, or a label is
// malformed. Valid as long as the inventory.
absl::StatusOr<std::vector<const bundle::InventoryRobot*>> Select(
    const bundle::Inventory& inventory, const RobotSelection& selection,
    const std::optional<std::string>& name);

struct PlannedStages {
  // Each with robots of its own.
  std::vector<std::vector<std::string>> stages;
  // `stage 2 (25%) has no robot that is not in a stage before it; it is left out`
  std::vector<std::string> notes;
};

// The stages, one of all robots if `stages` is empty. InvalidArgument: a stage is malformed or its
// label is of no robot, there are too many, or together they do not have all robots, which are
// named then.
absl::StatusOr<PlannedStages> PlanStages(const std::vector<const bundle::InventoryRobot*>& robots,
                                         const std::vector<StageSelection>& stages);

}  // namespace rips::rollout

#endif  // RIPS_POLICY_SERVER_SERVER_ROLLOUT_ROBOT_SELECTION_H_
