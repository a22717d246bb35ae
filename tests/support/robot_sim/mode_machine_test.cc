#include "tests/support/robot_sim/mode_machine.h"

#include <string>
#include <utility>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/ros2/parameter_messages.h"

namespace rips::robot_sim {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr absl::string_view kFile = R"(
safety:
  ros__parameters:
    type: system
    parts: eye wheels
    modes:
      __DEFAULT__: {eye: active, wheels: active}
      ALERT: {eye: inactive, wheels: active.SLOW}
      HALT: {eye: inactive, wheels: inactive}
outer:
  ros__parameters:
    type: system
    parts: safety
    modes:
      __DEFAULT__: {safety: active}
eye:
  ros__parameters:
    type: node
    modes:
      __DEFAULT__: {ros__parameters: {rate: 15.0}}
wheels:
  ros__parameters:
    type: node
    modes:
      __DEFAULT__: {ros__parameters: {max_speed: 1.0}}
      SLOW: {ros__parameters: {max_speed: 0.2}}
)";
constexpr int64_t kDelay = 150'000'000;

ModeMachine Machine(ManagerConduct conduct = ManagerConduct::kHonest) {
  absl::StatusOr<actuator::Smh> smh = actuator::ParseSmh(kFile);
  EXPECT_THAT(smh, IsOk());
  absl::StatusOr<ModeMachine> machine =
      ModeMachine::Create(*std::move(smh), {.transition_ns = kDelay, .conduct = conduct});
  EXPECT_THAT(machine, IsOk());
  return *std::move(machine);
}

TEST(ModeMachineTest, StartsInDefault) {
  const ModeMachine machine = Machine();
  EXPECT_EQ(machine.Mode("/safety"), "__DEFAULT__");
  EXPECT_EQ(machine.State("/safety"), Lifecycle::kActive);
  EXPECT_EQ(machine.Mode("/wheels"), "__DEFAULT__");
  EXPECT_TRUE(machine.nodes().at("/eye").active);
  EXPECT_THAT(machine.AvailableModes("/safety"), ElementsAre("ALERT", "HALT", "__DEFAULT__"));
}

TEST(ModeMachineTest, AnswersAtOnceAndSwitchesLater) {
  ModeMachine machine = Machine();

  EXPECT_TRUE(machine.ChangeMode("/safety", "ALERT", 1'000));

  EXPECT_FALSE(machine.Advance(kDelay + 999));
  EXPECT_EQ(machine.State("/safety"), Lifecycle::kActivating);
  EXPECT_EQ(machine.Mode("/safety"), "__DEFAULT__");
  EXPECT_TRUE(machine.Advance(kDelay + 1'000));
  EXPECT_EQ(machine.State("/safety"), Lifecycle::kActive);
  EXPECT_EQ(machine.Mode("/safety"), "ALERT");
  EXPECT_FALSE(machine.nodes().at("/eye").active);
  EXPECT_EQ(machine.nodes().at("/wheels").parameters.at("max_speed"), ros2::ParameterValue(0.2));
  EXPECT_FALSE(machine.Advance(kDelay * 10));
}

TEST(ModeMachineTest, RefusesUnknownModesAndParts) {
  ModeMachine machine = Machine();
  EXPECT_FALSE(machine.ChangeMode("/safety", "alert", 0));
  EXPECT_FALSE(machine.ChangeMode("/eye", "ALERT", 0));
  EXPECT_FALSE(machine.ChangeMode("/nobody", "__DEFAULT__", 0));
  EXPECT_FALSE(machine.Advance(kDelay * 10));
  EXPECT_EQ(machine.Mode("/nobody"), "unknown");
  EXPECT_EQ(machine.State("/nobody"), Lifecycle::kUnknown);
  EXPECT_THAT(machine.AvailableModes("/nobody"), IsEmpty());
}

TEST(ModeMachineTest, RedundantRequestDoesNotStopTheTransitionUnderWay) {
  ModeMachine machine = Machine();
  EXPECT_TRUE(machine.ChangeMode("/safety", "ALERT", 0));
  EXPECT_TRUE(machine.ChangeMode("/safety", "__DEFAULT__", 1));
  EXPECT_TRUE(machine.Advance(kDelay + 1));
  EXPECT_EQ(machine.Mode("/safety"), "ALERT");
}

TEST(ModeMachineTest, LaterRequestReplacesTheOneUnderWay) {
  ModeMachine machine = Machine();
  EXPECT_TRUE(machine.ChangeMode("/safety", "ALERT", 0));
  EXPECT_TRUE(machine.ChangeMode("/safety", "HALT", 1));
  EXPECT_FALSE(machine.Advance(kDelay));
  EXPECT_TRUE(machine.Advance(kDelay + 1));
  EXPECT_EQ(machine.Mode("/safety"), "HALT");
}

TEST(ModeMachineTest, ChangingOnePartLeavesNoFittingMode) {
  ModeMachine machine = Machine();
  EXPECT_TRUE(machine.ChangeMode("/wheels", "SLOW", 0));
  EXPECT_TRUE(machine.Advance(kDelay));
  EXPECT_EQ(machine.Mode("/wheels"), "SLOW");
  EXPECT_EQ(machine.Mode("/safety"), "");
  EXPECT_EQ(machine.State("/safety"), Lifecycle::kActivating);
  EXPECT_TRUE(machine.ChangeState("/eye", kTransitionDeactivate));
  EXPECT_EQ(machine.Mode("/safety"), "ALERT");
}

TEST(ModeMachineTest, ChangeStateNeedsTheRightStart) {
  ModeMachine machine = Machine();
  EXPECT_FALSE(machine.ChangeState("/eye", kTransitionActivate));
  EXPECT_FALSE(machine.ChangeState("/eye", 1));
  EXPECT_FALSE(machine.ChangeState("/nobody", kTransitionDeactivate));
  EXPECT_TRUE(machine.ChangeState("/eye", kTransitionDeactivate));
  EXPECT_EQ(machine.State("/eye"), Lifecycle::kInactive);
  EXPECT_EQ(machine.Mode("/eye"), "");
  EXPECT_FALSE(machine.ChangeState("/eye", kTransitionDeactivate));
  EXPECT_TRUE(machine.ChangeState("/eye", kTransitionActivate));
}

TEST(ModeMachineTest, LyingManagerAnswersSuccessAndDoesNothing) {
  ModeMachine machine = Machine(ManagerConduct::kLie);
  EXPECT_TRUE(machine.ChangeMode("/safety", "ALERT", 0));
  EXPECT_FALSE(machine.ChangeMode("/safety", "NO_SUCH", 0));
  EXPECT_FALSE(machine.Advance(kDelay * 10));
  EXPECT_EQ(machine.Mode("/safety"), "__DEFAULT__");
}

TEST(ModeMachineTest, DeceivingManagerClaimsTheModeButThePartsTellTheTruth) {
  ModeMachine machine = Machine(ManagerConduct::kDeceive);
  EXPECT_TRUE(machine.ChangeMode("/safety", "ALERT", 0));
  EXPECT_FALSE(machine.Advance(kDelay * 10));
  EXPECT_EQ(machine.Mode("/safety"), "ALERT");
  EXPECT_EQ(machine.State("/safety"), Lifecycle::kActive);
  EXPECT_EQ(machine.State("/eye"), Lifecycle::kActive);
}

TEST(ModeMachineTest, RefusingManagerAnswersFailure) {
  ModeMachine machine = Machine(ManagerConduct::kRefuse);
  EXPECT_FALSE(machine.ChangeMode("/safety", "ALERT", 0));
  EXPECT_FALSE(machine.Advance(kDelay * 10));
}

TEST(ModeMachineTest, RefusesFilesItCannotSimulate) {
  absl::StatusOr<actuator::Smh> smh = actuator::ParseSmh(kFile);
  ASSERT_THAT(smh, IsOk());
  EXPECT_THAT(ModeMachine::Create(*smh, {.system = "/nobody"}),
              StatusIs(absl::StatusCode::kNotFound, "no system `/nobody` in the file"));
  EXPECT_THAT(ModeMachine::Create(*smh, {.system = "/outer"}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("`/safety` is not a node")));
}

}  // namespace
}  // namespace rips::robot_sim
