// What the tools of ROS see of a sensor, and what a sensor sees of others that call themselves so.
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/agent.h"
#include "sensor_agent/fake_robot.h"
#include "sensor_agent/uplink/fake_policy_server.h"
#include "services/base/ids.h"
#include "services/base/status_matchers.h"
#include "services/rpc/credentials.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"
#include "tests/support/ros2/ros_view.h"

namespace rips::sensor {
namespace {

using dds::Eventually;
using ::testing::AllOf;
using ::testing::Each;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

class AnnounceTest : public testing::Test {
 protected:
  AnnounceTest()
      : dir_(std::filesystem::temp_directory_path() / absl::StrCat("rips-announce-", NewId())) {
    std::filesystem::create_directories(dir_);
  }
  ~AnnounceTest() override {
    if (agent_ != nullptr) agent_->Stop();
    server_.Stop();
    std::filesystem::remove_all(dir_);
  }

  void Start(bool announce = true) {
    const auto server = rpc::Credentials::Load(pki_.Server());
    ASSERT_THAT(server, IsOk());
    server_.Start((*server)->ForServer());
    const SensorConfig config{
        .robot = "r1",
        .host = "base",
        .servers = {server_.address()},
        .dds = {.domain = dds::RandomDomain(), .interface = "lo", .announce = announce},
        .watch = {.settle = absl::Milliseconds(500)},
        .state_dir = dir_.string()};
    const auto credentials = rpc::Credentials::Load(pki_.Sensor());
    ASSERT_THAT(credentials, IsOk());
    auto agent = Agent::Create(config, (*credentials)->ForClient(), &clock_, &metrics_);
    ASSERT_THAT(agent, IsOk());
    agent_ = *std::move(agent);
    agent_->Start();
    ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  }
  // Of the sensor's endpoints as ROS tools have them.
  std::vector<std::string> Shown(dds::RosView& ros) { return ros.NodesOf(agent_->participant()); }
  bool AllAre(dds::RosView& ros, size_t endpoints, const std::string& node) {
    return testing::Value(Shown(ros), AllOf(SizeIs(endpoints), Each(node)));
  }
  std::vector<std::string> Nodes() {
    std::vector<std::string> nodes;
    server_.WaitUntil([&](const FakePolicyServer& s) {
      for (const ros2::Node& node : s.graph.nodes()) nodes.push_back(node.full_name);
      return true;
    });
    return nodes;
  }

  const std::filesystem::path dir_;
  rpc::TestPki pki_;
  const RealClock clock_;
  Metrics metrics_;
  FakePolicyServer server_;
  FakeRobot robot_;
  std::unique_ptr<Agent> agent_;
};

TEST_F(AnnounceTest, EveryReaderIsOfNodeRipsAsTheyComeAndGo) {
  const auto tool = robot_.AddParticipant();
  dds::RosView ros(*tool, ros2::GidBytes::k24);
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/chatter");
  talker->Announce("talker");
  Start();
  ASSERT_TRUE(Eventually([&] { return AllAre(ros, 1, "/rips"); }));
  server_.WaitUntil([&](const FakePolicyServer& s) {
    EXPECT_EQ(s.hellos.back().participant_guid(), agent_->participant().ToBytes());
    return true;
  });

  for (size_t i = 1; i <= 8; ++i) {
    talker->AddWriter(absl::StrCat("rt/t", i));
    talker->Announce("talker");
    ASSERT_TRUE(Eventually([&] { return Shown(ros).size() == 1 + i; }));
    // Its claim follows at once, or after the interval.
    EXPECT_TRUE(Eventually([&] { return AllAre(ros, 1 + i, "/rips"); }, absl::Seconds(2))) << i;
  }
  for (size_t i = 1; i <= 8; ++i) talker->RemoveWriter(absl::StrCat("rt/t", i));
  talker->Announce("talker");
  EXPECT_TRUE(Eventually([&] { return AllAre(ros, 1, "/rips"); }));
  EXPECT_THAT(Nodes(), testing::UnorderedElementsAre("/rips", "/talker")) << "counted once";
}

TEST_F(AnnounceTest, SpeaksAsTheNodesOfTheBusDo) {
  const auto tool = robot_.AddParticipant();
  dds::RosView jazzy(*tool, ros2::GidBytes::k16);
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/chatter");
  talker->Announce("talker", ros2::GidBytes::k16);
  Start();
  EXPECT_TRUE(Eventually([&] { return AllAre(jazzy, 1, "/rips"); }));
  // The robot is moved to another distribution of ROS.
  dds::RosView humble(*tool, ros2::GidBytes::k24);
  talker->Announce("talker", ros2::GidBytes::k24);
  EXPECT_TRUE(Eventually([&] { return AllAre(humble, 1, "/rips"); }));
}

TEST_F(AnnounceTest, HiddenIfTheFileSaysSo) {
  const auto tool = robot_.AddParticipant();
  dds::RosView ros(*tool, ros2::GidBytes::k24);
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/chatter");
  talker->Announce("talker");
  Start(/*announce=*/false);
  ASSERT_TRUE(Eventually([&] { return Shown(ros).size() == 1; }));
  talker->AddWriter("rt/t");
  talker->Announce("talker");
  ASSERT_TRUE(Eventually([&] { return Shown(ros).size() == 2; }));
  absl::SleepFor(absl::Milliseconds(500));
  EXPECT_THAT(Shown(ros), Each(Not("/rips")));
  EXPECT_FALSE(ros.HasClaimOf(agent_->participant()));
  EXPECT_THAT(metrics_.Text(), testing::HasSubstr("rips_sensor_announced 0"));
}

TEST_F(AnnounceTest, OtherAgentsThatAnnounceThemselvesAreNeitherFoundNorForgotten) {
  // The actuator and another host's sensor; the server names them a moment later, and is started
  // again then without knowing them.
  auto actuator = robot_.AddProcess();
  actuator->AddWriter("rq/safety/change_modeRequest");
  actuator->Announce("rips");
  auto sensor = robot_.AddProcess();
  sensor->Announce("rips");
  server_.Set([](FakePolicyServer::Behaviour& b) { b.protected_parts = {"/safety"}; });
  Start();
  rips::v1::SensorReply reply;
  reply.mutable_config()->add_protected_parts("/safety");
  for (const FakeProcess* each : {actuator.get(), sensor.get()}) {
    reply.mutable_config()->add_own_participants(each->participant().guid().ToBytes());
  }
  absl::SleepFor(absl::Seconds(2));
  server_.Send(reply);
  absl::SleepFor(absl::Seconds(1));
  reply.mutable_config()->clear_own_participants();
  server_.Send(reply);
  absl::SleepFor(absl::Seconds(6));
  server_.WaitUntil([](const FakePolicyServer& s) {
    for (const Recorded& each : s.Distinct(rips::v1::CONTROL)) {
      EXPECT_FALSE(each.what.has_finding()) << each.what.ShortDebugString();
    }
    return true;
  });
  EXPECT_THAT(Nodes(), testing::ElementsAre("/rips", "/rips", "/rips"));
}

}  // namespace
}  // namespace rips::sensor
