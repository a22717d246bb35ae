#include "policy_server/server/rollout/robot_selection.h"

#include <algorithm>
#include <set>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/rollout/rollout.h"
#include "services/base/status_macros.h"

namespace rips::rollout {
namespace {

using bundle::InventoryRobot;
using Robots = std::vector<const InventoryRobot*>;

bool HasAll(const InventoryRobot& robot, const std::vector<std::string>& labels) {
  return std::all_of(labels.begin(), labels.end(),
                     [&](const std::string& label) { return robot.HasLabel(label); });
}

absl::StatusOr<Robots> SelectNamed(const bundle::Inventory& inventory,
                                   const std::vector<std::string>& names,
                                   const std::optional<std::string>& policy) {
  Robots robots;
  for (const std::string& name : std::set<std::string>(names.begin(), names.end())) {
    const InventoryRobot* robot = inventory.Find(name);
    if (robot == nullptr) {
      return absl::NotFoundError(
          absl::StrCat("robot `", absl::CHexEscape(name), "` is not in the inventory"));
    }
    if (policy && robot->bundle != *policy) {
      return absl::FailedPreconditionError(
          absl::StrCat("the inventory has policy `", robot->bundle, "` for robot `", name,
                       "`; the bundle is of policy `", *policy,
                       "`: give it that name, or the robot that `bundle` in the inventory"));
    }
    robots.push_back(robot);
  }
  return robots;
}

absl::Status CheckStage(const StageSelection& stage) {
  if (stage.label.empty() == (stage.percent == 0)) {
    return absl::InvalidArgumentError("a stage is a label or a percentage");
  }
  if (stage.percent > 100) {
    return absl::InvalidArgumentError("the percentage of a stage is from 1 to 100");
  }
  return stage.label.empty() ? absl::OkStatus() : bundle::ParseLabel(stage.label).status();
}

}  // namespace

absl::StatusOr<Robots> Select(const bundle::Inventory& inventory, const RobotSelection& selection,
                              const std::optional<std::string>& name) {
  const int given = (selection.robots.empty() ? 0 : 1) + (selection.labels.empty() ? 0 : 1) +
                    (selection.all ? 1 : 0);
  if (given != 1) {
    return absl::InvalidArgumentError("name robots, or labels, or all of them: exactly one");
  }
  if (!selection.robots.empty()) return SelectNamed(inventory, selection.robots, name);
  for (const std::string& label : selection.labels) {
    RIPS_RETURN_IF_ERROR(bundle::ParseLabel(label).status());
  }
  Robots robots;
  for (const InventoryRobot& robot : inventory.robots) {
    if ((!name || robot.bundle == *name) && HasAll(robot, selection.labels)) {
      robots.push_back(&robot);
    }
  }
  if (robots.empty()) {
    return absl::NotFoundError(absl::StrCat(
        "the inventory has no robot", name ? absl::StrCat(" with policy `", *name, "`") : "",
        selection.labels.empty() ? ""
                                 : absl::StrCat(" with ", absl::StrJoin(selection.labels, ", "))));
  }
  return robots;
}

absl::StatusOr<PlannedStages> PlanStages(const Robots& robots,
                                         const std::vector<StageSelection>& stages) {
  if (stages.size() > kStagesMax) {
    return absl::InvalidArgumentError(absl::StrCat("there are more than ", kStagesMax, " stages"));
  }
  PlannedStages plan;
  std::set<std::string> placed;
  int number = 0;
  for (const StageSelection& stage :
       stages.empty() ? std::vector<StageSelection>{{.percent = 100}} : stages) {
    RIPS_RETURN_IF_ERROR(CheckStage(stage));
    ++number;
    const bool labelled = !stage.label.empty();
    const auto has = [&](const InventoryRobot* robot) { return robot->HasLabel(stage.label); };
    if (labelled && std::none_of(robots.begin(), robots.end(), has)) {
      return absl::InvalidArgumentError(
          absl::StrCat("no robot of the selection has ", stage.label, ", stage ", number));
    }
    const size_t first = (robots.size() * stage.percent + 99) / 100;
    std::vector<std::string> fresh;
    for (size_t i = 0; i < robots.size(); ++i) {
      const bool in = labelled ? has(robots[i]) : i < first;
      if (in && placed.insert(robots[i]->id).second) fresh.push_back(robots[i]->id);
    }
    if (!fresh.empty()) {
      plan.stages.push_back(std::move(fresh));
    } else {
      plan.notes.push_back(absl::StrCat(
          "stage ", number, " (", labelled ? stage.label : absl::StrCat(stage.percent, "%"),
          ") has no robot that is not in a stage before it; it is left out"));
    }
  }
  std::vector<std::string> left;
  for (const InventoryRobot* robot : robots) {
    if (!placed.contains(robot->id)) left.push_back(robot->id);
  }
  if (left.empty()) return plan;
  return absl::InvalidArgumentError(
      absl::StrCat("the stages leave out ", absl::StrJoin(left, ", "), "; end them with 100%"));
}

}  // namespace rips::rollout
