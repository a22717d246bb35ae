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

TEST(ModeMachineTest, NodesMakeTheTransitionsOfTheLifecycle) {
  ModeMachine machine = Machine();
  EXPECT_FALSE(machine.ChangeState("/eye", kTransitionActivate));
  EXPECT_FALSE(machine.ChangeState("/eye", kTransitionCleanup));
  EXPECT_TRUE(machine.ChangeState("/eye", kTransitionDeactivate));
  EXPECT_TRUE(machine.ChangeState("/eye", kTransitionCleanup));
  EXPECT_EQ(machine.State("/eye"), Lifecycle::kUnconfigured);
  EXPECT_FALSE(machine.ChangeState("/eye", kTransitionActivate));
  // The mode manager does nothing with it.
  EXPECT_TRUE(machine.ChangeMode("/safety", "__DEFAULT__", 0));
  machine.Advance(kDelay);
  EXPECT_EQ(machine.State("/eye"), Lifecycle::kUnconfigured);
  EXPECT_TRUE(machine.ChangeState("/eye", kTransitionConfigure));
  EXPECT_EQ(machine.State("/eye"), Lifecycle::kInactive);
  EXPECT_TRUE(machine.ChangeState("/eye", kTransitionActivate));
  EXPECT_EQ(machine.TrueMode(), "__DEFAULT__");
}

TEST(ModeMachineTest, ParametersAreSetAllOrNoneAndMakeTheMode) {
  ModeMachine machine = Machine();
  EXPECT_EQ(machine.SetParameters("/wheels", {{"max_speed", 0.2}}), "");
  EXPECT_EQ(machine.Mode("/wheels"), "SLOW");
  EXPECT_THAT(machine.SetParameters("/wheels", {{"max_speed", 1.0}, {"x", 1.0}}),
              HasSubstr("not been declared"));
  EXPECT_THAT(machine.SetParameters("/wheels", {{"max_speed", std::string("1")}}),
              HasSubstr("wrong parameter type"));
  EXPECT_EQ(machine.Mode("/wheels"), "SLOW");
  EXPECT_EQ(machine.SetParameters("/wheels", {{"max_speed", 0.7}}), "");
  EXPECT_EQ(machine.Mode("/wheels"), "");
  EXPECT_NE(machine.SetParameters("/nobody", {}), "");
}

TEST(ModeMachineTest, AStuckNodeStaysAsItIs) {
  ModeMachine machine = Machine();
  machine.SetStuck("/eye", true);
  EXPECT_FALSE(machine.ChangeState("/eye", kTransitionDeactivate));
  EXPECT_NE(machine.SetParameters("/eye", {{"rate", 1.0}}), "");
  machine.ChangeMode("/safety", "HALT", 0);
  machine.Advance(kDelay);
  EXPECT_EQ(machine.State("/eye"), Lifecycle::kActive);
  EXPECT_EQ(machine.State("/wheels"), Lifecycle::kInactive);
}

TEST(ModeMachineTest, ARestartedManagerKnowsNothingUntilEachNodeHasMoved) {
  ModeMachine machine = Machine();
  machine.ChangeMode("/safety", "ALERT", 0);
  machine.ForgetModes();
  machine.Advance(kDelay);
  EXPECT_EQ(machine.TrueMode(), "__DEFAULT__") << "what was pending is forgotten";
  EXPECT_EQ(machine.Mode("/safety"), "unknown");
  EXPECT_EQ(machine.State("/safety"), Lifecycle::kUnknown);
  machine.ChangeMode("/safety", "ALERT", kDelay);
  machine.Advance(2 * kDelay);
  EXPECT_EQ(machine.Mode("/safety"), "ALERT");
}

TEST(ModeMachineTest, AManagerWithRulesLeavesTheMode) {
  ModeMachine machine = Machine();
  machine.SetPull("ALERT", "__DEFAULT__");
  machine.ChangeMode("/safety", "ALERT", 0);
  machine.Advance(kDelay);
  EXPECT_EQ(machine.Mode("/safety"), "ALERT");
  machine.Advance(kDelay + 1'000'000'000);
  machine.Advance(2 * kDelay + 1'000'000'000);
  EXPECT_EQ(machine.Mode("/safety"), "__DEFAULT__");
}

TEST(ModeMachineTest, ARemovedModeIsNotTaken) {
  ModeMachine machine = Machine();
  machine.RemoveMode("ALERT");
  EXPECT_THAT(machine.AvailableModes("/safety"), ElementsAre("HALT", "__DEFAULT__"));
  EXPECT_FALSE(machine.ChangeMode("/safety", "ALERT", 0));
}

}  // namespace
}  // namespace rips::robot_sim
