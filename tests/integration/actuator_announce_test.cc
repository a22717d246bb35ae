// What the tools of ROS see of the whole actuator, over real DDS and without a server.
#include <stdlib.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_replace.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/link/agent.h"
#include "services/base/status_matchers.h"
#include "services/dds/discovery.h"
#include "services/dds/ros_view.h"
#include "services/dds/test_world.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

using ::testing::AllOf;
using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr absl::string_view kSmh = R"(safety:
  ros__parameters:
    type: system
    modes:
      __DEFAULT__: {eye: active}
      ALERT: {eye: inactive}
eye:
  ros__parameters:
    type: node
    modes: {__DEFAULT__: {ros__parameters: {rate: 15.0}}}
)";
constexpr absl::string_view kConfig = R"(robot: r1
host: base
servers: ["127.0.0.1:1"]
tls: {ca: DIR/none, cert: DIR/none, key: DIR/none}
dds: {domain: 3, announce: ANNOUNCE}
state_dir: DIR/state
fail_safe: {level: ALERT, after: 0s}
system_modes: {smh: DIR/smh.yaml}
levels:
  - {name: DEFAULT, enter: [{system_mode: {part: /safety, mode: __DEFAULT__}}]}
  - {name: ALERT, enter: [{system_mode: {part: /safety, mode: ALERT}}]}
metrics: "127.0.0.1:0"
)";

class ActuatorAnnounceTest : public dds::TestWorld {
 protected:
  ActuatorAnnounceTest() {
    char name[] = "/tmp/rips-announce-XXXXXX";
    dir_ = mkdtemp(name);
    std::ofstream(dir_ + "/smh.yaml") << kSmh;
    std::filesystem::create_directory(dir_ + "/state");
    auto discovery = dds::Discovery::Create(
        far(), {.on_participant = [this](const dds::ParticipantSeen& seen) { OnParticipant(seen); },
                .on_endpoint = [](const dds::EndpointSeen&) {}});
    EXPECT_THAT(discovery, IsOk());
    discovery_ = *std::move(discovery);
  }
  ~ActuatorAnnounceTest() override {
    agent_.reset();
    discovery_.reset();
    std::filesystem::remove_all(dir_);
  }

  void Start(const std::string& announce) {
    std::ofstream(dir_ + "/actuator.yaml")
        << absl::StrReplaceAll(kConfig, {{"DIR", dir_}, {"ANNOUNCE", announce}});
    const auto loaded = LoadConfig(dir_ + "/actuator.yaml");
    ASSERT_THAT(loaded, IsOk());
    const dds::ScopedCycloneUri uri(dds::WireUri());
    auto agent =
        Agent::Start(*loaded, rpc::CredentialsSource(loaded->config.tls), &clock_, &metrics_);
    ASSERT_THAT(agent, IsOk());
    agent_ = *std::move(agent);
    ASSERT_TRUE(dds::Eventually([this] { return !participant().none(); }));
  }
  // The actuator's.
  ros2::Guid participant() {
    MutexLock lock(&mu_);
    return participant_;
  }

  dds::RosView ros_{far(), ros2::GidBytes::k24};
  Metrics metrics_;
  std::unique_ptr<Agent> agent_;

 private:
  void OnParticipant(const dds::ParticipantSeen& seen) {
    if (seen.guid.SamePrefix(near().guid()) || seen.guid.SamePrefix(far().guid())) return;
    MutexLock lock(&mu_);
    participant_ = seen.guid;
  }

  const RealClock clock_;
  std::string dir_;
  Mutex mu_;
  ros2::Guid participant_ ABSL_GUARDED_BY(mu_);
  std::unique_ptr<dds::Discovery> discovery_;
};

TEST_F(ActuatorAnnounceTest, WhatItAsksTheSystemModesWithIsOfNodeRips) {
  Start("true");
  EXPECT_TRUE(dds::Eventually([this] {
    return testing::Value(ros_.NodesOf(participant()), AllOf(Not(IsEmpty()), Each("/rips")));
  }));
  EXPECT_THAT(metrics_.Text(), HasSubstr("rips_actuator_announced 1"));
}

TEST_F(ActuatorAnnounceTest, HiddenIfTheFileSaysSo) {
  Start("false");
  ASSERT_TRUE(dds::Eventually([this] { return !ros_.NodesOf(participant()).empty(); }));
  absl::SleepFor(absl::Milliseconds(500));
  EXPECT_THAT(ros_.NodesOf(participant()), Each(Not("/rips")));
  EXPECT_FALSE(ros_.HasClaimOf(participant()));
  EXPECT_THAT(metrics_.Text(), HasSubstr("rips_actuator_announced 0"));
}

}  // namespace
}  // namespace rips::actuator
