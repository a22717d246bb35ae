// The whole actuator without its recorded state, or with one from a backup, and without a server,
// on a simulated robot over real DDS: it does not lower the robot.
#include <sys/stat.h>

#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/decide/actuator_state.h"
#include "tests/integration/actuator_world.h"
#include "tests/support/robot_sim/living_robot.h"

namespace rips::actuator {
namespace {

using robot_sim::LivingRobot;
using robot_sim::ModeMachine;
using ::testing::Each;

class LostStateTest : public ActuatorWorld {
 protected:
  ~LostStateTest() override {
    StopActuator();
    robot_.reset();
  }

  void StartRobot(const std::string& mode) {
    robot_ = std::make_unique<LivingRobot>(far(), *ParseSmh(robot_sim::kLivingRobotSmh));
    if (mode != kDefaultMode) Move(mode);
  }
  // As if it was there all the time.
  void Move(const std::string& mode) {
    (*robot_)->With([&](ModeMachine& machine) { machine.ChangeMode("/safety", mode, 0); });
    ASSERT_TRUE(dds::Eventually([&] { return (*robot_)->Mode() == mode; }));
    robot_->TakeModes();
  }
  std::string State() const {
    std::stringstream text;
    text << std::ifstream(dir_ + "/state/state").rdbuf();
    return text.str();
  }
  bool Records(const std::string& level) const {
    return dds::Eventually(
        [&] { return absl::StrContains(State(), absl::StrCat("effective ", level, "\n")); });
  }
  // The level was entered, whatever it is.
  bool Ordered(int orders = 1) {
    return dds::Eventually([&] { return (*robot_)->orders() >= orders; });
  }

  std::unique_ptr<LivingRobot> robot_;
};

TEST_F(LostStateTest, ARobotAtAMoreRestrictiveLevelStaysThere) {
  StartRobot("HALT");
  StartActuator();
  EXPECT_TRUE(Records("HALT"));
  EXPECT_TRUE(Ordered());
  EXPECT_THAT(robot_->TakeModes(), Each("HALT"));

  // Once more, with the record that this has left.
  StopActuator();
  StartActuator();
  EXPECT_TRUE(Ordered(2));
  EXPECT_TRUE(Records("HALT"));
  EXPECT_THAT(robot_->TakeModes(), Each("HALT"));
}

TEST_F(LostStateTest, TheNodesShowTheLevelWhenTheManagerHasForgotten) {
  std::ofstream(dir_ + "/state/state") << "rips-actuator-state 1\nmark 1.1\ndecided DEFAULT\n";
  StartRobot("HALT");
  (*robot_)->With([](ModeMachine& machine) { machine.ForgetModes(); });
  StartActuator();
  EXPECT_TRUE(Records("HALT"));
  EXPECT_TRUE(Ordered());
  EXPECT_THAT(robot_->TakeModes(), Each("HALT"));
}

TEST_F(LostStateTest, AStateFromABackupDoesNotLowerTheRobot) {
  std::ofstream(dir_ + "/state/state") << EncodeState(
      {.decision_id = {1, 1}, .decided = "ALERT", .effective = "ALERT", .highest_term = 1});
  StartRobot("HALT");
  StartActuator();
  EXPECT_TRUE(Records("HALT"));
  EXPECT_TRUE(Ordered());
  EXPECT_THAT(robot_->TakeModes(), Each("HALT"));
}

TEST_F(LostStateTest, ARobotBelowTheFailSafeLevelIsBroughtThere) {
  StartRobot("__DEFAULT__");
  StartActuator();
  EXPECT_TRUE(dds::Eventually([&] { return (*robot_)->Mode() == "ALERT"; }));
  EXPECT_TRUE(Records("ALERT"));
}

TEST_F(LostStateTest, ARobotInAModeOfNoLevelIsBroughtToTheFailSafeLevel) {
  StartRobot("__DEFAULT__");
  ASSERT_TRUE(robot_->ChangeState("/wheels", robot_sim::kTransitionDeactivate));
  ASSERT_TRUE(dds::Eventually([&] { return (*robot_)->Mode().empty(); }));
  StartActuator();
  EXPECT_TRUE(dds::Eventually([&] { return (*robot_)->Mode() == "ALERT"; }));
  EXPECT_TRUE(Records("ALERT"));
}

TEST_F(LostStateTest, ASilentRobotIsBroughtToTheFailSafeLevelWhenItComes) {
  StartActuator();
  EXPECT_TRUE(Records("ALERT"));
  StartRobot("__DEFAULT__");
  EXPECT_TRUE(dds::Eventually([&] { return (*robot_)->Mode() == "ALERT"; }));

  // Nothing was decided meanwhile: the next start surveys again.
  StopActuator();
  Move("HALT");
  StartActuator();
  EXPECT_TRUE(Records("HALT"));
  EXPECT_THAT(robot_->TakeModes(), Each("HALT"));
}

}  // namespace
}  // namespace rips::actuator
