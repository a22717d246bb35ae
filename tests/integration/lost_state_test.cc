// The whole actuator without its recorded state, or with one from a backup, and without a server, on
// a simulated robot over real DDS: it does not lower the robot.
#include <stdlib.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/decide/actuator_state.h"
#include "mode_actuator/link/agent.h"
#include "services/base/status_matchers.h"
#include "services/dds/test_world.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/living_robot.h"

namespace rips::actuator {
namespace {

using robot_sim::LivingRobot;
using robot_sim::ModeMachine;
using ::testing::Each;

constexpr absl::string_view kSmh = R"(safety:
  ros__parameters:
    type: system
    modes:
      __DEFAULT__: {eye: active, wheels: active}
      ALERT: {eye: inactive, wheels: active.SLOW}
      HALT: {eye: inactive, wheels: inactive}
eye:
  ros__parameters:
    type: node
    modes: {__DEFAULT__: {ros__parameters: {rate: 15.0}}}
wheels:
  ros__parameters:
    type: node
    modes:
      __DEFAULT__: {ros__parameters: {max_speed: 1.0}}
      SLOW: {ros__parameters: {max_speed: 0.2}}
)";
constexpr absl::string_view kConfig = R"(robot: r1
host: base
servers: ["127.0.0.1:1"]
tls: {ca: DIR/none, cert: DIR/none, key: DIR/none}
dds: {domain: 3, announce: false}
state_dir: DIR/state
fail_safe: {level: ALERT, after: 0s}
timing: {reconcile: 200ms}
system_modes: {smh: DIR/smh.yaml}
levels:
  - {name: DEFAULT, enter: [{system_mode: {part: /safety, mode: __DEFAULT__}}]}
  - {name: ALERT, enter: [{system_mode: {part: /safety, mode: ALERT}}]}
  - {name: HALT, enter: [{system_mode: {part: /safety, mode: HALT}}]}
metrics: "127.0.0.1:0"
)";

class LostStateTest : public dds::TestWorld {
 protected:
  LostStateTest() {
    char name[] = "/tmp/rips-lost-state-XXXXXX";
    dir_ = mkdtemp(name);
    std::ofstream(dir_ + "/smh.yaml") << kSmh;
    std::ofstream(dir_ + "/actuator.yaml") << absl::StrReplaceAll(kConfig, {{"DIR", dir_}});
    std::filesystem::create_directory(dir_ + "/state");
  }
  ~LostStateTest() override {
    agent_.reset();
    robot_.reset();
    std::filesystem::remove_all(dir_);
  }

  void StartRobot(const std::string& mode) {
    robot_ = std::make_unique<LivingRobot>(far(), *ParseSmh(kSmh));
    if (mode != kDefaultMode) Move(mode);
  }
  // As if it was there all the time.
  void Move(const std::string& mode) {
    (*robot_)->With([&](ModeMachine& machine) { machine.ChangeMode("/safety", mode, 0); });
    ASSERT_TRUE(dds::Eventually([&] { return (*robot_)->Mode() == mode; }));
    robot_->TakeModes();
  }
  void StartActuator() {
    const auto loaded = LoadConfig(dir_ + "/actuator.yaml");
    ASSERT_THAT(loaded, IsOk());
    const dds::ScopedCycloneUri uri(dds::WireUri());
    auto agent =
        Agent::Start(*loaded, rpc::CredentialsSource(loaded->config.tls), &clock_, &metrics_);
    ASSERT_THAT(agent, IsOk());
    agent_ = *std::move(agent);
  }
  void StopActuator() { agent_.reset(); }
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

  const RealClock clock_;
  Metrics metrics_;
  std::string dir_;
  std::unique_ptr<LivingRobot> robot_;
  std::unique_ptr<Agent> agent_;
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
  std::ofstream(dir_ + "/state/state")
      << EncodeState({.mark = {1, 1}, .decided = "ALERT", .effective = "ALERT", .highest_term = 1});
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
