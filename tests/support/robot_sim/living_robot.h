// A simulated robot in the process of a test.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_LIVING_ROBOT_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_LIVING_ROBOT_H_

#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/system_mode/smh.h"
#include "services/base/status_matchers.h"
#include "services/dds/participant.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/mode_machine.h"
#include "tests/support/robot_sim/robot.h"
#include "tests/support/robot_sim/stop_flag.h"

namespace rips::robot_sim {

// The system modes of the robot that most tests have.
inline constexpr absl::string_view kLivingRobotSmh = R"(safety:
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

// Lives on a thread of its own. Any thread.
class LivingRobot {
 public:
  LivingRobot(const dds::Participant& participant, const actuator::Smh& smh,
              ManagerConduct conduct = ManagerConduct::kHonest,
              absl::Duration answer_delay = absl::ZeroDuration()) {
    auto machine = ModeMachine::Create(smh, {.conduct = conduct});
    EXPECT_THAT(machine, IsOk());
    auto robot = Robot::Create(participant.domain(), *std::move(machine),
                               {.conduct = conduct, .answer_delay = answer_delay});
    EXPECT_THAT(robot, IsOk());
    robot_ = *std::move(robot);
    thread_ = std::thread([this] {
      while (!stop_.WaitFor(absl::Milliseconds(2))) Step();
    });
  }
  ~LivingRobot() {
    stop_.Stop();
    thread_.join();
  }

  Robot& operator*() { return *robot_; }
  Robot* operator->() { return robot_.get(); }
  void StopManager() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    robot_->StopManager();
  }
  void StartManager() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    EXPECT_THAT(robot_->StartManager(), IsOk());
  }
  void Stick(const char* node, bool stuck = true) {
    robot_->With([&](ModeMachine& machine) { machine.SetStuck(node, stuck); });
  }
  // What somebody else does to a node.
  bool ChangeState(const char* node, uint8_t transition) {
    return robot_->With(
        [&](ModeMachine& machine) { return machine.ChangeState(node, transition); });
  }
  // Each mode the system has been in since the last call; "" for none.
  std::vector<std::string> TakeModes() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return std::exchange(modes_, {});
  }

 private:
  void Step() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    robot_->Step();
    std::string mode = robot_->Mode();
    if (modes_.empty() || modes_.back() != mode) modes_.push_back(std::move(mode));
  }

  const RealClock clock_;
  StopFlag stop_;
  Mutex mu_;
  std::unique_ptr<Robot> robot_;
  std::vector<std::string> modes_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_LIVING_ROBOT_H_
