// The whole actuator in the process of a test, on real DDS and without a server.
#ifndef RIPS_TESTS_INTEGRATION_ACTUATOR_WORLD_H_
#define RIPS_TESTS_INTEGRATION_ACTUATOR_WORLD_H_

#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_replace.h"
#include "absl/strings/string_view.h"
#include "gtest/gtest.h"
#include "mode_actuator/link/agent.h"
#include "services/base/status_matchers.h"
#include "services/runtime/metrics.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/living_robot.h"
#include "tests/support/ros2/test_world.h"

namespace rips::actuator {

inline constexpr absl::string_view kWorldConfig = R"(robot: r1
host: base
servers: ["127.0.0.1:1"]
tls: {ca: DIR/none, cert: DIR/none, key: DIR/none}
dds: {domain: 3, announce: ANNOUNCE}
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

// Its files are in `dir_`, its recorded state in `dir_`/state.
class ActuatorWorld : public dds::TestWorld {
 protected:
  ActuatorWorld() {
    char name[] = "/tmp/rips-actuator-XXXXXX";
    dir_ = mkdtemp(name);
    std::ofstream(dir_ + "/smh.yaml") << robot_sim::kLivingRobotSmh;
    std::filesystem::create_directory(dir_ + "/state");
  }
  ~ActuatorWorld() override {
    agent_.reset();
    std::filesystem::remove_all(dir_);
  }

  // `announce`: whether it is a node of ROS.
  void StartActuator(bool announce = false) {
    const std::string file = dir_ + "/actuator.yaml";
    std::ofstream(file) << absl::StrReplaceAll(
        kWorldConfig, {{"DIR", dir_}, {"ANNOUNCE", announce ? "true" : "false"}});
    const auto loaded = LoadConfig(file);
    ASSERT_THAT(loaded, IsOk());
    const dds::ScopedCycloneUri uri(dds::WireUri());
    auto agent =
        Agent::Start(*loaded, rpc::CredentialsSource(loaded->config.tls), &clock_, &metrics_);
    ASSERT_THAT(agent, IsOk());
    agent_ = *std::move(agent);
  }
  void StopActuator() { agent_.reset(); }

  const RealClock clock_;
  Metrics metrics_;
  std::string dir_;
  std::unique_ptr<Agent> agent_;
};

}  // namespace rips::actuator

#endif  // RIPS_TESTS_INTEGRATION_ACTUATOR_WORLD_H_
