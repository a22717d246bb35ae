// Hostile processes on a real bus, and what the sensor says of them.
#include <algorithm>
#include <filesystem>
#include <functional>
#include <optional>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/agent.h"
#include "sensor_agent/fake_robot.h"
#include "sensor_agent/uplink/fake_policy_server.h"
#include "services/base/status_matchers.h"
#include "services/rpc/credentials.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"
#include "tests/support/ros2/forged_rtps.h"
#include "tests/support/ros2/test_keystore.h"

namespace rips::sensor {
namespace {

using rips::v1::CONTROL;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr char kChangeModeRequest[] = "rq/safety/change_modeRequest";
constexpr char kChangeModeType[] = "system_modes_msgs::srv::dds_::ChangeMode_Request_";
constexpr char kStringType[] = "std_msgs::msg::dds_::String_";

class AgentFindingsTest : public testing::Test {
 protected:
  ~AgentFindingsTest() override {
    if (agent_ != nullptr) agent_->Stop();
    server_.Stop();
    EXPECT_THAT(server_.violations, IsEmpty());
  }

  void StartServer() {
    const auto credentials = rpc::Credentials::Load(pki_.Server());
    ASSERT_THAT(credentials, IsOk());
    server_.Start((*credentials)->ForServer());
  }
  SensorConfig Config() {
    return {.robot = "r1",
            .host = "base",
            .servers = {server_.address()},
            .dds = {.domain = dds::RandomDomain(), .interface = "lo"},
            .watch = {.settle = absl::Milliseconds(500)}};
  }
  absl::StatusOr<std::unique_ptr<Agent>> Create(const SensorConfig& config) {
    const auto credentials = rpc::Credentials::Load(pki_.Sensor());
    return Agent::Create(config, (*credentials)->ForClient(), &clock_, &metrics_);
  }
  void StartAgent(const SensorConfig& config) {
    auto agent = Create(config);
    ASSERT_THAT(agent, IsOk());
    agent_ = *std::move(agent);
    agent_->Start();
    ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  }
  void Start() {
    StartServer();
    StartAgent(Config());
  }

  static std::vector<rips::v1::Finding> Told(const FakePolicyServer& server) {
    std::vector<rips::v1::Finding> told;
    for (const Recorded& each : server.Distinct(CONTROL)) {
      if (each.what.has_finding()) told.push_back(each.what.finding());
    }
    return told;
  }
  std::vector<rips::v1::Finding> Told() {
    std::vector<rips::v1::Finding> told;
    server_.WaitUntil([&](const FakePolicyServer& s) {
      told = Told(s);
      return true;
    });
    return told;
  }
  std::vector<std::string> Kinds() {
    std::vector<std::string> kinds;
    for (const rips::v1::Finding& each : Told()) kinds.push_back(each.kind());
    return kinds;
  }
  // The first one of that kind that begins; nullopt if there is none in 20 s.
  std::optional<rips::v1::Finding> WaitFor(const std::string& kind, bool over = false) {
    std::optional<rips::v1::Finding> found;
    server_.WaitUntil([&](const FakePolicyServer& s) {
      for (const rips::v1::Finding& each : Told(s)) {
        if (each.kind() == kind && each.over() == over) found = each;
      }
      return found.has_value();
    });
    return found;
  }

  rpc::TestPki pki_;
  const RealClock clock_;
  Metrics metrics_;
  FakePolicyServer server_;
  std::unique_ptr<Agent> agent_;
};

class HostileProcessTest : public AgentFindingsTest {
 protected:
  FakeRobot robot_;
};

TEST_F(HostileProcessTest, TakesTheNameOfAnotherNode) {
  auto camera = robot_.AddProcess();
  camera->AddWriter("rt/image");
  camera->Announce("camera");
  Start();
  auto second = robot_.AddProcess();
  second->Announce("camera");

  const auto finding = WaitFor("duplicate_node");
  ASSERT_TRUE(finding.has_value());
  EXPECT_EQ(finding->node(), "/camera");
  EXPECT_EQ(finding->guid(), second->participant().guid().ToBytes());
  second.reset();
  const auto over = WaitFor("duplicate_node", /*over=*/true);
  ASSERT_TRUE(over.has_value());
  EXPECT_EQ(over->guid(), finding->guid());
  EXPECT_THAT(Kinds(), ElementsAre("duplicate_node", "duplicate_node"));
}

TEST_F(HostileProcessTest, ReadsWithoutANode) {
  auto camera = robot_.AddProcess();
  camera->AddWriter("rt/image");
  camera->Announce("camera");
  Start();
  auto viewer = robot_.AddProcess();
  viewer->AddReader("rt/image");
  viewer->Announce("viewer");
  auto thief = robot_.AddParticipant();
  auto stolen = dds::RawReader::Create(*thief, {.topic = "rt/image", .type = kStringType},
                                       [](const dds::RawSample&) {});
  ASSERT_THAT(stolen, IsOk());

  const auto finding = WaitFor("non_ros_reader");
  ASSERT_TRUE(finding.has_value());
  EXPECT_EQ(finding->topic(), "/image");
  EXPECT_EQ(finding->guid(), thief->guid().ToBytes());
  EXPECT_THAT(finding->detail(), HasSubstr("reads without a node"));
  stolen->reset();
  ASSERT_TRUE(WaitFor("non_ros_reader", /*over=*/true).has_value());
  EXPECT_THAT(Kinds(), ElementsAre("non_ros_reader", "non_ros_reader"));
}

TEST_F(HostileProcessTest, CallsItselfRipsAndClaimsEndpointsOfOthers) {
  auto camera = robot_.AddProcess();
  const ros2::Guid writer = camera->AddWriter("rt/image").guid();
  camera->Announce("camera");
  Start();
  auto evil = robot_.AddProcess();
  evil->Announce("rips");
  const auto impostor = WaitFor("impostor");
  ASSERT_TRUE(impostor.has_value());
  EXPECT_EQ(impostor->node(), "/rips");
  EXPECT_EQ(impostor->guid(), evil->participant().guid().ToBytes());

  evil->Announce("evil", ros2::GidBytes::k24, {writer});
  const auto claim = WaitFor("false_claim");
  ASSERT_TRUE(claim.has_value());
  EXPECT_EQ(claim->guid(), evil->participant().guid().ToBytes());
  EXPECT_THAT(claim->detail(), HasSubstr("1 endpoints of other participants"));
  EXPECT_TRUE(WaitFor("impostor", /*over=*/true).has_value()) << "it has another name now";
  evil->Announce("evil");
  EXPECT_TRUE(WaitFor("false_claim", /*over=*/true).has_value());
}

TEST_F(HostileProcessTest, WritesToATopicWithoutBeingANode) {
  auto base = robot_.AddProcess();
  base->AddWriter("rt/cmd_vel");
  base->Announce("base");
  Start();
  auto evil = robot_.AddParticipant();
  const auto writer = dds::RawWriter::Create(*evil, {.topic = "rt/cmd_vel", .type = kStringType});
  ASSERT_THAT(writer, IsOk());

  const auto finding = WaitFor("non_ros_writer");
  ASSERT_TRUE(finding.has_value());
  EXPECT_EQ(finding->topic(), "/cmd_vel");
  EXPECT_EQ(finding->guid(), (*writer)->guid().ToBytes());
  evil.reset();
  EXPECT_TRUE(WaitFor("non_ros_writer", /*over=*/true).has_value());
  EXPECT_THAT(Kinds(), ElementsAre("non_ros_writer", "non_ros_writer"));
}

TEST_F(HostileProcessTest, SteersAProtectedPartAndRipsAndTheManagerMay) {
  // Who serves change_mode may steer the parts below.
  auto manager = robot_.AddProcess();
  manager->AddReader(kChangeModeRequest);
  manager->AddWriter("rq/safety/set_parametersRequest");
  manager->Announce("mode_manager");
  auto actuator = robot_.AddParticipant();
  const auto own =
      dds::RawWriter::Create(*actuator, {.topic = kChangeModeRequest, .type = kChangeModeType});
  ASSERT_THAT(own, IsOk());
  server_.Set([&](FakePolicyServer::Behaviour& b) {
    b.own_participants = {actuator->guid().ToBytes()};
    b.protected_parts = {"/safety", "not a name"};
  });
  Start();
  auto evil = robot_.AddProcess();
  const ros2::Guid writer = evil->AddWriter(kChangeModeRequest).guid();
  evil->AddWriter("rq/lidar/change_modeRequest");
  evil->Announce("evil");

  const auto finding = WaitFor("foreign_mode_writer");
  ASSERT_TRUE(finding.has_value());
  EXPECT_EQ(finding->guid(), writer.ToBytes());
  EXPECT_EQ(finding->node(), "/evil");
  EXPECT_EQ(finding->topic(), "/safety/change_mode");
  EXPECT_THAT(Kinds(), ElementsAre("foreign_mode_writer")) << "and nobody else";
}

TEST_F(HostileProcessTest, ServesAProtectedPartWithoutANode) {
  constexpr char kGetStateRequest[] = "rq/camera/get_stateRequest";
  constexpr char kGetStateType[] = "lifecycle_msgs::srv::dds_::GetState_Request_";
  server_.Set([](FakePolicyServer::Behaviour& b) { b.protected_parts = {"/camera"}; });
  auto camera = robot_.AddProcess();
  camera->AddReader(kGetStateRequest);
  camera->Announce("camera");
  Start();
  auto rival = robot_.AddParticipant();
  auto server = dds::RawReader::Create(*rival, {.topic = kGetStateRequest, .type = kGetStateType},
                                       [](const dds::RawSample&) {});
  ASSERT_THAT(server, IsOk());

  const auto finding = WaitFor("rival_server");
  ASSERT_TRUE(finding.has_value());
  EXPECT_EQ(finding->guid(), rival->guid().ToBytes());
  EXPECT_EQ(finding->topic(), "/camera/get_state");
  EXPECT_THAT(finding->detail(), HasSubstr("without a node"));
  server->reset();
  EXPECT_TRUE(WaitFor("rival_server", /*over=*/true).has_value());
  EXPECT_THAT(Kinds(), ElementsAre("rival_server", "rival_server"));
}

// One forged datagram, under the name of a best-effort writer, a latched one, and of discovery.
TEST_F(HostileProcessTest, SequenceNumbersThatJumpMakeNobodyDeaf) {
  constexpr uint64_t kForged = uint64_t{1} << 40;
  auto laser = robot_.AddProcess();
  const ros2::Guid scan = laser->AddWriter("rt/scan", {.depth = 1}).guid();
  const ros2::Guid map =
      laser->AddWriter("rt/map", {.reliable = true, .transient_local = true, .depth = 2}).guid();
  laser->Announce("laser");
  Start();
  const auto heard = [&](const std::string& topic) {
    return dds::Eventually([&] {
      laser->Publish("rt" + topic, "after");
      bool last = false;
      server_.WaitUntil([&](const FakePolicyServer& s) {
        const auto all = s.Distinct(rips::v1::MESSAGES);
        for (const Recorded& each : all) {
          if (each.topic != topic) continue;
          const uint64_t number = each.what.message().writer_sequence();
          last = number > 0 && number < kForged;
        }
        return true;
      });
      return last;
    });
  };
  const auto visible = [&](const ros2::Guid& guid) {
    bool found = false;
    server_.WaitUntil([&](const FakePolicyServer& s) {
      const auto it = s.graph.endpoints().find(guid);
      found =
          it != s.graph.endpoints().end() && it->second.visibility == ros2::Visibility::kWatched;
      return true;
    });
    return found;
  };
  ASSERT_TRUE(heard("/scan"));
  ASSERT_TRUE(heard("/map"));
  EXPECT_TRUE(visible(scan));

  dds::SendForged(dds::ForgedData(scan, kForged, std::string("\0\1\0\0\0\0\0\0", 8)), true);
  dds::SendForged(dds::ForgedHeartbeat(map, kForged, kForged), true);
  ros2::Guid publications = laser->participant().guid();
  publications.bytes[14] = 0x03;
  publications.bytes[15] = 0xc2;
  publications.bytes[12] = publications.bytes[13] = 0;
  dds::SendForged(dds::ForgedHeartbeat(publications, kForged, kForged), true);

  ASSERT_TRUE(dds::Eventually([&] { return Kinds().size() >= 3; }));
  std::set<std::string> guids;
  for (const rips::v1::Finding& each : Told()) {
    EXPECT_EQ(each.kind(), "sequence_jump");
    guids.insert(each.guid());
  }
  EXPECT_THAT(guids,
              testing::UnorderedElementsAre(scan.ToBytes(), map.ToBytes(), publications.ToBytes()));
  EXPECT_TRUE(dds::Eventually([&] { return !visible(scan) && !visible(map); }));
  EXPECT_TRUE(heard("/scan"));
  EXPECT_TRUE(heard("/map"));
  const ros2::Guid late = laser->AddWriter("rt/late").guid();
  EXPECT_TRUE(dds::Eventually([&] { return visible(late); })) << "discovery is heard, too";

  laser->RemoveWriter("rt/scan");
  const auto over = WaitFor("sequence_jump", /*over=*/true);
  ASSERT_TRUE(over.has_value());
  EXPECT_EQ(over->guid(), scan.ToBytes());
}

TEST_F(HostileProcessTest, StandingFindingsAreToldAgainToAServerThatForgot) {
  Start();
  auto evil = robot_.AddProcess();
  evil->Announce("rips");
  ASSERT_TRUE(WaitFor("impostor").has_value());
  server_.Stop();
  server_.Set([](FakePolicyServer::Behaviour& b) { b.forget = true; });
  StartServer();
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) { return Told(s).size() == 2; }));
  EXPECT_THAT(Kinds(), ElementsAre("impostor", "impostor"));
}

// --- DDS Security

class SecuredRobotTest : public AgentFindingsTest {
 protected:
  SecuredRobotTest() {
    keystore_.Mint("/rips/sensor", "sensor");
    keystore_.Mint("/talker", "node");
    talker_ = robot_.AddProcess(keystore_.Load("/talker"));
    talker_->AddWriter("rt/chatter");
    talker_->Announce("talker");
  }
  SensorConfig Secured() {
    SensorConfig config = Config();
    config.dds.keystore = keystore_.dir();
    config.dds.enclave = "/rips/sensor";
    return config;
  }

  dds::TestKeystore keystore_;
  FakeRobot robot_{1};
  FakeRobot strangers_{2};
  FakeRobot impostors_{3};
  std::unique_ptr<FakeProcess> talker_;
};

TEST_F(SecuredRobotTest, SeesTheRobotAndTellsOfThoseWhoDoNotAuthenticate) {
  StartServer();
  StartAgent(Secured());
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    talker_->Publish("rt/chatter");
    const ros2::Topic* topic = s.graph.FindTopic("/chatter");
    const bool message =
        std::any_of(s.received.begin(), s.received.end(), [](const Recorded& each) {
          return each.topic == "/chatter" && each.what.has_message() &&
                 each.writer.node() == "/talker";
        });
    return message && topic != nullptr && topic->publishers == std::vector<std::string>{"/talker"};
  }));
  auto stranger = strangers_.AddProcess();
  stranger->AddWriter("rt/chatter");
  stranger->Announce("stranger");
  dds::TestKeystore wrong;
  wrong.Mint("/talker", "node");
  auto impostor = impostors_.AddProcess(wrong.Load("/talker"));
  impostor->AddWriter("rt/chatter");

  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    stranger->Publish("rt/chatter");
    impostor->Publish("rt/chatter");
    std::vector<std::string> guids;
    for (const rips::v1::Finding& each : Told(s)) {
      if (each.kind() == "unauthenticated" && !each.over()) guids.push_back(each.guid());
    }
    return testing::Matches(testing::UnorderedElementsAre(
        stranger->participant().guid().ToBytes(), impostor->participant().guid().ToBytes()))(guids);
  }));
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    const auto& participants = s.graph.participants();
    const auto authenticated = [&](const ros2::Guid& guid) {
      const auto it = participants.find(guid);
      return it != participants.end() && it->second.authenticated;
    };
    return authenticated(talker_->participant().guid()) && authenticated(agent_->participant()) &&
           !authenticated(stranger->participant().guid()) &&
           !authenticated(impostor->participant().guid());
  }));
  EXPECT_THAT(Kinds(), Not(Contains(AllOf(Not("unauthenticated")))));
  stranger.reset();
  EXPECT_TRUE(WaitFor("unauthenticated", /*over=*/true).has_value());
}

TEST_F(SecuredRobotTest, SensorWithoutSecuritySaysThatItSeesNothing) {
  StartServer();
  StartAgent(Config());
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    talker_->Publish("rt/chatter");
    for (const Recorded& each : s.Distinct(CONTROL)) {
      const auto& kinds = each.what.state().not_visible();
      if (std::find(kinds.begin(), kinds.end(), kSecuredParticipants) != kinds.end()) return true;
    }
    return false;
  }));
  EXPECT_TRUE(server_.WaitUntil(
      [](const FakePolicyServer& s) { return s.graph.FindTopic("/chatter") == nullptr; }));
  EXPECT_THAT(Kinds(), IsEmpty());
  // And in the hello of the next stream.
  server_.Stop();
  StartServer();
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    return testing::Matches(Contains(kSecuredParticipants))(s.hellos.back().not_visible());
  }));
}

TEST_F(SecuredRobotTest, SensorWithAKeyThatIsNotItsOwnDoesNotStart) {
  const std::string key = keystore_.File("/rips/sensor", "key.pem");
  std::filesystem::copy_file(keystore_.File("/talker", "key.pem"), key,
                             std::filesystem::copy_options::overwrite_existing);
  StartServer();
  EXPECT_THAT(Create(Secured()),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr(absl::StrCat("`", key, "` is not the key of `"))));
}

}  // namespace
}  // namespace rips::sensor
