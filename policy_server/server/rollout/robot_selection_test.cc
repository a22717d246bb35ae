#include "policy_server/server/rollout/robot_selection.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "services/base/status_matchers.h"

namespace rips::rollout {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

bundle::Inventory Fleet() {
  bundle::Inventory inventory;
  const auto add = [&](const std::string& id, const std::string& policy, const std::string& ring) {
    inventory.robots.push_back({.id = id, .bundle = policy, .labels = {{"ring", ring}}});
  };
  add("d1", "dock", "main");
  add("r1", "warehouse", "main");
  add("r2", "warehouse", "canary");
  add("r3", "warehouse", "main");
  add("r4", "warehouse", "main");
  return inventory;
}

std::vector<std::string> Ids(const std::vector<const bundle::InventoryRobot*>& robots) {
  std::vector<std::string> ids;
  for (const bundle::InventoryRobot* robot : robots) ids.push_back(robot->id);
  return ids;
}

TEST(SelectTest, ChoosesByNameByLabelOrAllOfThePolicy) {
  const bundle::Inventory fleet = Fleet();
  EXPECT_THAT(Ids(*Select(fleet, {.robots = {"r3", "r1", "r3"}}, "warehouse")),
              ElementsAre("r1", "r3"));
  EXPECT_THAT(Ids(*Select(fleet, {.labels = {"ring=main"}}, "warehouse")),
              ElementsAre("r1", "r3", "r4"));
  EXPECT_THAT(Ids(*Select(fleet, {.all = true}, "warehouse")), ElementsAre("r1", "r2", "r3", "r4"));
  EXPECT_THAT(Ids(*Select(fleet, {.labels = {"ring=main"}}, std::nullopt)),
              ElementsAre("d1", "r1", "r3", "r4"));
}

TEST(SelectTest, SaysWhatIsWrong) {
  const bundle::Inventory fleet = Fleet();
  EXPECT_THAT(Select(fleet, {.robots = {"r9"}}, "warehouse"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("`r9` is not in the inventory")));
  EXPECT_THAT(Select(fleet, {.robots = {"r1", "d1"}}, "warehouse"),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("policy `dock`")));
  EXPECT_THAT(Select(fleet, {}, "warehouse"), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(Select(fleet, {.robots = {"r1"}, .all = true}, "warehouse"),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(Select(fleet, {.labels = {"ring"}}, "warehouse"),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(Select(fleet, {.labels = {"ring=none"}}, "warehouse"),
              StatusIs(absl::StatusCode::kNotFound, HasSubstr("with ring=none")));
  EXPECT_THAT(Select(fleet, {.all = true}, "crane"), StatusIs(absl::StatusCode::kNotFound));
}

TEST(PlanStagesTest, EachStageHasTheRobotsThatNoneBeforeItHas) {
  const bundle::Inventory fleet = Fleet();
  const auto robots = *Select(fleet, {.all = true}, "warehouse");
  EXPECT_THAT(PlanStages(robots, {})->stages, ElementsAre(ElementsAre("r1", "r2", "r3", "r4")));
  EXPECT_THAT(
      PlanStages(robots, {{.label = "ring=canary"}, {.percent = 30}, {.percent = 100}})->stages,
      ElementsAre(ElementsAre("r2"), ElementsAre("r1"), ElementsAre("r3", "r4")));
  // Of four, 1 % is one; a stage without robots of its own is none, and named.
  const auto plan = PlanStages(robots, {{.percent = 1}, {.percent = 25}, {.percent = 100}});
  EXPECT_THAT(plan->stages, ElementsAre(ElementsAre("r1"), ElementsAre("r2", "r3", "r4")));
  EXPECT_THAT(plan->notes, ElementsAre(HasSubstr("stage 2 (25%) has no robot")));
}

TEST(PlanStagesTest, RefusesStagesThatLeaveRobotsOut) {
  const bundle::Inventory fleet = Fleet();
  const auto robots = *Select(fleet, {.all = true}, "warehouse");
  EXPECT_THAT(PlanStages(robots, {{.label = "ring=main"}}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("the stages leave out r2; end them with 100%")));
  // A typing error must not make one stage of all.
  EXPECT_THAT(PlanStages(robots, {{.label = "ring=canari"}, {.percent = 100}}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("has ring=canari")));
  EXPECT_THAT(PlanStages(robots, {{.percent = 101}}), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(PlanStages(robots, {{}}), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(PlanStages(robots, {{.label = "ring=main", .percent = 5}}),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(PlanStages(robots, {{.label = "=x"}, {.percent = 100}}),
              StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(PlanStages(robots, std::vector<StageSelection>(33, {.percent = 100})),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

}  // namespace
}  // namespace rips::rollout
