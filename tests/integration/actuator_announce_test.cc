// What the tools of ROS see of the whole actuator, over real DDS and without a server.
#include <memory>

#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/dds/discovery.h"
#include "services/runtime/mutex.h"
#include "tests/integration/actuator_world.h"
#include "tests/support/ros2/ros_view.h"

namespace rips::actuator {
namespace {

using ::testing::AllOf;
using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

class ActuatorAnnounceTest : public ActuatorWorld {
 protected:
  ActuatorAnnounceTest() {
    auto discovery = dds::Discovery::Create(
        far(), {.on_participant = [this](const dds::ParticipantSeen& seen) { OnParticipant(seen); },
                .on_endpoint = [](const dds::EndpointSeen&) {}});
    EXPECT_THAT(discovery, IsOk());
    discovery_ = *std::move(discovery);
  }
  ~ActuatorAnnounceTest() override {
    StopActuator();
    discovery_.reset();
  }

  void Start(bool announce) {
    StartActuator(announce);
    ASSERT_TRUE(dds::Eventually([this] { return !participant().none(); }));
  }
  // The actuator's.
  ros2::Guid participant() {
    MutexLock lock(&mu_);
    return participant_;
  }

  dds::RosView ros_{far(), ros2::GidBytes::k24};

 private:
  void OnParticipant(const dds::ParticipantSeen& seen) {
    if (seen.guid.SamePrefix(near().guid()) || seen.guid.SamePrefix(far().guid())) return;
    MutexLock lock(&mu_);
    participant_ = seen.guid;
  }

  Mutex mu_;
  ros2::Guid participant_ ABSL_GUARDED_BY(mu_);
  std::unique_ptr<dds::Discovery> discovery_;
};

TEST_F(ActuatorAnnounceTest, WhatItAsksTheSystemModesWithIsOfNodeRips) {
  Start(true);
  EXPECT_TRUE(dds::Eventually([this] {
    return testing::Value(ros_.NodesOf(participant()), AllOf(Not(IsEmpty()), Each("/rips")));
  }));
  EXPECT_THAT(metrics_.Text(), HasSubstr("rips_actuator_announced 1"));
}

TEST_F(ActuatorAnnounceTest, HiddenIfTheFileSaysSo) {
  Start(false);
  ASSERT_TRUE(dds::Eventually([this] { return !ros_.NodesOf(participant()).empty(); }));
  absl::SleepFor(absl::Milliseconds(500));
  EXPECT_THAT(ros_.NodesOf(participant()), Each(Not("/rips")));
  EXPECT_FALSE(ros_.HasClaimOf(participant()));
  EXPECT_THAT(metrics_.Text(), HasSubstr("rips_actuator_announced 0"));
}

}  // namespace
}  // namespace rips::actuator
