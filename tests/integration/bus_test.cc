// A whole sensor on a bus with other processes: what it tells the policy server of them.
#include <filesystem>
#include <fstream>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "grpcpp/security/credentials.h"
#include "gtest/gtest.h"
#include "sensor_agent/agent.h"
#include "sensor_agent/fake_robot.h"
#include "sensor_agent/uplink/fake_policy_server.h"
#include "services/base/status_matchers.h"
#include "services/rpc/credentials.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"
#include "tests/integration/bus_world.h"
#include "tests/support/robot_sim/ros_process.h"

namespace rips::sensor {
namespace {

using bus::Child;
using dds::Eventually;
using rips::v1::CONTROL;
using rips::v1::MESSAGES;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using ::testing::UnorderedElementsAre;

constexpr char kString[] = "std_msgs::msg::dds_::String_";
bool own_network = false;

std::string Publish(const std::string& topic, const std::string& more,
                    const std::string& type = kString) {
  return absl::StrCat(topic, ",", type, ",", more);
}

class BusTest : public testing::Test {
 protected:
  BusTest() : dir_(std::filesystem::temp_directory_path() / absl::StrCat("rips-bus-", NewId())) {
    std::filesystem::create_directories(dir_);
    server_.Start(grpc::InsecureServerCredentials());
  }
  ~BusTest() override {
    if (agent_ != nullptr) agent_->Stop();
    server_.Stop();
    EXPECT_THAT(server_.violations, IsEmpty());
    std::filesystem::remove_all(dir_);
  }

  void StartAgent() {
    const SensorConfig config{.robot = "r1",
                              .host = "base",
                              .servers = {server_.address()},
                              .dds = {.domain = dds::RandomDomain(), .interface = "lo"},
                              .watch = {.settle = absl::Milliseconds(500)},
                              .state_dir = dir_.string()};
    auto agent = Agent::Create(config, grpc::InsecureChannelCredentials(), &clock_, &metrics_);
    ASSERT_THAT(agent, IsOk());
    agent_ = *std::move(agent);
    agent_->Start();
    ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  }
  std::vector<std::string> Arguments(std::vector<std::string> more) {
    more.insert(more.begin(), {"--domain", absl::StrCat(dds::RandomDomain())});
    return more;
  }
  static std::vector<std::string> Nodes(const FakePolicyServer& server) {
    std::vector<std::string> nodes;
    for (const ros2::Node& node : server.graph.nodes()) nodes.push_back(node.full_name);
    return nodes;
  }
  testing::AssertionResult WaitForNodes(const std::vector<std::string>& nodes) {
    std::vector<std::string> last;
    if (server_.WaitUntil([&](const FakePolicyServer& s) { return (last = Nodes(s)) == nodes; })) {
      return testing::AssertionSuccess();
    }
    return testing::AssertionFailure() << "nodes are " << testing::PrintToString(last);
  }
  // Of `topic`, by writer, each number once.
  std::map<std::string, std::vector<uint64_t>> Sequences(const std::string& topic) {
    std::map<std::string, std::vector<uint64_t>> sequences;
    EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
      for (const Recorded& each : s.Distinct(MESSAGES)) {
        if (each.topic == topic) {
          sequences[each.writer.guid()].push_back(each.what.message().writer_sequence());
        }
      }
      return true;
    }));
    return sequences;
  }
  bool WaitForMessage(const std::string& topic, const std::string& node) {
    return server_.WaitUntil([&](const FakePolicyServer& s) {
      for (const Recorded& each : s.received) {
        if (each.lane == MESSAGES && each.topic == topic && each.writer.node() == node) return true;
      }
      return false;
    });
  }
  // Every endpoint that was ever in the graph, as it was last said.
  std::map<std::string, rips::v1::Endpoint> EverSeen() {
    std::map<std::string, rips::v1::Endpoint> seen;
    EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
      for (const Recorded& each : s.received) {
        for (const auto& endpoint : each.what.delta().upsert_endpoints()) {
          seen[endpoint.guid()] = endpoint;
        }
      }
      return true;
    }));
    return seen;
  }

  const std::filesystem::path dir_;
  const RealClock clock_;
  Metrics metrics_;
  FakeRobot robot_;
  FakePolicyServer server_;
  std::unique_ptr<Agent> agent_;
};

TEST_F(BusTest, MixedDurabilitiesAndTypesOnOneTopicAreReadOnceEach) {
  Child peer(
      "dds_peer",
      Arguments({"--node", "/mixer", "--short-gids", "--count", "20", "--tail-ms", "50",
                 "--publish", Publish("rt/mix", "latched,depth=50"), "--publish",
                 Publish("rt/mix", "reliable,depth=50"), "--publish", Publish("rt/mix", "depth=50"),
                 "--publish", Publish("rt/mix", "reliable", "other::msg::dds_::Odd_"), "--publish",
                 Publish("rt/mix", "reliable,partition=aside")}));
  ASSERT_TRUE(peer.WaitFor("up"));
  StartAgent();
  ASSERT_TRUE(WaitForMessage("/mix", "/mixer"));
  ASSERT_TRUE(Eventually([&] { return Sequences("/mix").size() == 5; }));
  for (const auto& [writer, sequences] : Sequences("/mix")) {
    for (size_t i = 1; i < sequences.size(); ++i) {
      EXPECT_EQ(sequences[i], sequences[i - 1] + 1) << "neither twice nor missing";
    }
  }
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    const ros2::Topic* topic = s.graph.FindTopic("/mix");
    return topic->types == std::vector<std::string>{"other/msg/Odd", "std_msgs/msg/String"} &&
           topic->publishers == std::vector<std::string>(5, "/mixer");
  }));
}

TEST_F(BusTest, AVisitOfATenthOfASecondIsSeenWithItsMessages) {
  auto base = robot_.AddProcess();
  const auto subscriber = *dds::RawReader::Create(
      base->participant(), {.topic = "rt/visited", .type = kString}, [](const dds::RawSample&) {});
  StartAgent();
  ASSERT_TRUE(server_.WaitUntil(
      [](const FakePolicyServer& s) { return s.graph.FindTopic("/visited") != nullptr; }));
  Child visitor("dds_peer",
                Arguments({"--node", "/visitor", "--publish", Publish("rt/visited", "reliable"),
                           "--readers", "2", "--count", "10", "--period-us", "10000"}));
  ASSERT_TRUE(visitor.End(0));
  EXPECT_THAT(visitor.Line("sent"), "sent rt/visited 10");
  ASSERT_TRUE(WaitForMessage("/visited", "/visitor"));
  ASSERT_TRUE(WaitForNodes({"/rips"}));
  int shown = 0;
  for (const auto& [guid, endpoint] : EverSeen()) {
    if (endpoint.name() == "/visited" && endpoint.node() == "/visitor") ++shown;
  }
  EXPECT_EQ(shown, 1);
}

TEST_F(BusTest, AnUnnamedVisitorThatIsGoneAtOnceIsShown) {
  StartAgent();
  for (int i = 0; i < 5; ++i) {
    Child visitor("dds_peer",
                  Arguments({"--publish", Publish(absl::StrCat("rt/flash", i), "reliable"),
                             "--readers", "1", "--count", "1", "--period-us", "0"}));
    ASSERT_TRUE(visitor.End(0));
  }
  for (int i = 0; i < 5; ++i) {
    const std::string topic = absl::StrCat("/flash", i);
    EXPECT_TRUE(Eventually([&] {
      for (const auto& [guid, endpoint] : EverSeen()) {
        if (endpoint.name() == topic && endpoint.kind() == rips::v1::Endpoint::PUBLISHER &&
            !endpoint.pending()) {
          return true;
        }
      }
      return false;
    })) << topic;
  }
  EXPECT_TRUE(WaitForNodes({"/rips"}));
}

TEST_F(BusTest, AProcessThatDiesWithoutAWordLeavesAfterItsLease) {
  const std::string uri = getenv("CYCLONEDDS_URI");
  const std::string element = "<Discovery>";
  setenv("CYCLONEDDS_URI",
         std::string(uri)
             .replace(uri.find(element), element.size(),
                      "<Discovery><LeaseDuration>2s</LeaseDuration>")
             .c_str(),
         1);
  Child victim("dds_peer",
               Arguments({"--node", "/victim", "--publish", Publish("rt/a", "depth=1")}));
  Child twin("dds_peer", Arguments({"--node", "/twin", "--enclave", "/cell"}));
  Child other("dds_peer", Arguments({"--node", "/twin"}));
  setenv("CYCLONEDDS_URI", uri.c_str(), 1);
  StartAgent();
  ASSERT_TRUE(WaitForNodes({"/rips", "/twin", "/twin", "/victim"})) << "one name, two processes";
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    std::set<std::pair<uint32_t, std::string>> told;
    for (const auto& [guid, each] : s.graph.participants()) {
      if (!each.host.empty() && each.vendor == "0110") told.insert({each.pid, each.enclave});
    }
    return told.contains({static_cast<uint32_t>(twin.pid()), "/cell"}) &&
           told.contains({static_cast<uint32_t>(other.pid()), "/"});
  }));
  ASSERT_TRUE(victim.End(SIGKILL));
  ASSERT_TRUE(twin.End(SIGKILL));
  EXPECT_TRUE(WaitForNodes({"/rips", "/twin"}));
  EXPECT_TRUE(server_.WaitUntil(
      [](const FakePolicyServer& s) { return s.graph.FindTopic("/a") == nullptr; }));
}

TEST_F(BusTest, ANodeOfRosIsThereWithServicesActionsAndParameters) {
  auto process = *robot_sim::RosProcess::Create(robot_.domain(), ros2::GidBytes::k24);
  robot_sim::RosNode* node = *process->AddNode("/ns/mover");
  for (const char* part : {"send_goal", "get_result", "cancel_goal"}) {
    ASSERT_THAT(node->Serve(absl::StrCat("/ns/move/_action/", part), "std_srvs/srv/SetBool"),
                IsOk());
  }
  ASSERT_THAT(node->Publish("/ns/move/_action/status", "action_msgs/msg/GoalStatusArray",
                            {.reliable = true, .transient_local = true, .depth = 1}),
              IsOk());
  ASSERT_THAT(process->Announce(), IsOk());
  StartAgent();
  std::vector<std::string> services;
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    services = s.graph.ServicesOf("/ns/mover");
    return services.size() == 9;
  }));
  EXPECT_THAT(services, testing::IsSupersetOf(
                            {"/ns/move/_action/send_goal", "/ns/move/_action/cancel_goal",
                             "/ns/mover/get_parameters", "/ns/mover/set_parameters_atomically"}));
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    const ros2::Topic* status = s.graph.FindTopic("/ns/move/_action/status");
    return status != nullptr && status->publishers == std::vector<std::string>{"/ns/mover"};
  }));
  // Every endpoint says how far it is seen.
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    for (const auto& [guid, endpoint] : s.graph.endpoints()) {
      const bool service = endpoint.kind == ros2::EndpointKind::kService ||
                           endpoint.kind == ros2::EndpointKind::kClient;
      EXPECT_NE(endpoint.visibility, ros2::Visibility::kUnspecified) << endpoint.name;
      EXPECT_EQ(service, endpoint.visibility == ros2::Visibility::kNotVisible) << endpoint.name;
      EXPECT_EQ(service, !endpoint.why.empty()) << endpoint.name;
    }
    return true;
  }));
}

TEST_F(BusTest, HostileClaimsOfEveryLengthAreCountedAndHarmNobody) {
  auto process = robot_.AddProcess();
  process->AddWriter("rt/chatter");
  StartAgent();
  const std::string good = ros2::EncodeParticipantEntities(
      {.participant = process->participant().guid(),
       .nodes = {{.node_namespace = "/", .node_name = "n"}, {"/", "m", {}, {}}}});
  for (size_t size = 4; size <= good.size(); ++size) {
    process->AnnounceBytes(good.substr(0, size));
    process->AnnounceBytes(good.substr(0, 4) + std::string(size, '\xff'));
    process->AnnounceBytes(good + std::string(size, '\0'));
  }
  process->AnnounceBytes(std::string("\0\1\0\0", 4) + std::string(300'000, 'n'));
  ASSERT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    for (const Recorded& each : s.received) {
      if (each.what.loss().cause() == rips::v1::Loss::UNDECODABLE) return true;
    }
    return false;
  }));
  process->Announce("honest");
  EXPECT_TRUE(WaitForNodes({"/honest", "/rips"}));
}

TEST_F(BusTest, AParticipantThatFlapsLeavesNothingBehind) {
  auto base = robot_.AddProcess();
  base->AddWriter("rt/steady");
  base->Announce("base");
  StartAgent();
  ASSERT_TRUE(WaitForNodes({"/base", "/rips"}));
  for (int i = 0; i < 150; ++i) {
    auto flapping = robot_.AddProcess();
    flapping->AddWriter("rt/flap");
    flapping->Announce("flap");
    absl::SleepFor(absl::Milliseconds(10));
    flapping.reset();
    absl::SleepFor(absl::Milliseconds(10));
  }
  EXPECT_TRUE(WaitForNodes({"/base", "/rips"}));
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    return s.graph.FindTopic("/flap") == nullptr && s.graph.participants().size() == 2;
  }));
  base->Publish("rt/steady");
  EXPECT_TRUE(WaitForMessage("/steady", "/base"));
}

TEST_F(BusTest, OfTwoHostsOfOneRobotOnlyThePrimaryTellsOfTheBus) {
  rpc::TestPki pki;
  FakePolicyServer fleet;
  fleet.Set([](auto& b) { b.primary_host = "base"; });
  const auto credentials = rpc::Credentials::Load(pki.Server());
  ASSERT_THAT(credentials, IsOk());
  fleet.Start((*credentials)->ForServer());
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/chatter");
  talker->Announce("talker");
  std::vector<std::unique_ptr<Child>> sensors;
  for (const std::string host : {"base", "laptop"}) {
    const TlsFiles tls = pki.Sensor("r1", host);
    std::filesystem::create_directories(dir_ / host);
    const std::string config = (dir_ / host / "sensor.yaml").string();
    std::ofstream(config) << "robot: r1\nhost: " << host << "\nservers: [\"" << fleet.address()
                          << "\"]\ntls: {ca: " << tls.ca << ", cert: " << tls.cert
                          << ", key: " << tls.key << "}\ndds: {domain: " << dds::RandomDomain()
                          << ", interface: lo}\nmetrics: \"127.0.0.1:0\"\nstate_dir: "
                          << (dir_ / host).string() << "\n";
    sensors.push_back(
        std::make_unique<Child>("rips-sensor", std::vector<std::string>{"--config", config}));
    const std::string ready = absl::StrCat(host, " is there");
    ASSERT_TRUE(fleet.WaitUntil([&](const FakePolicyServer& s) {
      return s.hellos.size() == sensors.size() && s.hellos.back().hello().host() == host;
    })) << ready;
  }
  std::map<std::string, std::string> host_of;
  ASSERT_TRUE(fleet.WaitUntil([&](const FakePolicyServer& s) {
    for (const auto& hello : s.hellos) host_of[hello.hello().incarnation()] = hello.hello().host();
    return s.settled;
  }));
  // One reader, that of the primary.
  EXPECT_TRUE(Eventually([&] { return talker->MatchedReaders("rt/chatter") == 1; }));
  kill(sensors[1]->pid(), SIGUSR1);
  std::set<std::string> signals;
  std::set<std::string> bus;
  EXPECT_TRUE(fleet.WaitUntil([&](const FakePolicyServer& s) {
    talker->Publish("rt/chatter");
    for (const Recorded& each : s.received) {
      if (each.what.has_signal()) signals.insert(host_of[each.incarnation]);
      if (each.lane == MESSAGES || each.what.has_snapshot() || each.what.has_delta()) {
        bus.insert(host_of[each.incarnation]);
      }
    }
    return !signals.empty() && !s.Distinct(MESSAGES).empty();
  }));
  EXPECT_THAT(signals, ElementsAre("laptop"));
  EXPECT_THAT(bus, ElementsAre("base"));
  sensors.clear();
  fleet.Stop();
  EXPECT_THAT(fleet.violations, IsEmpty());
}

// --- Nodes on Fast DDS, which knows no tag: in a network of their own.

class FastBusTest : public BusTest {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(absl::StrCat(RIPS_BIN_DIR, "/fastdds_peer"))) {
      GTEST_SKIP() << "Fast DDS is not installed";
    }
    if (!own_network) GTEST_SKIP() << "no network namespace is granted; run as root";
    setenv("CYCLONEDDS_URI",
           "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" "
           "multicast=\"true\"/></Interfaces></General><Discovery><ParticipantIndex>none"
           "</ParticipantIndex></Discovery></Domain></CycloneDDS>",
           1);
  }
};

TEST_F(FastBusTest, TopicsAreReadWithAndWithoutSharedMemory) {
  Child shm("fastdds_peer", Arguments({"--node", "/ns/shm", "--publish", "rt/shm"}));
  Child udp("fastdds_peer",
            Arguments({"--node", "/udp", "--publish", "rt/udp", "--latched", "--udp-only"}));
  ASSERT_TRUE(shm.WaitFor("up"));
  ASSERT_TRUE(udp.WaitFor("up"));
  StartAgent();
  EXPECT_TRUE(WaitForMessage("/shm", "/ns/shm"));
  EXPECT_TRUE(WaitForMessage("/udp", "/udp"));
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    int fast = 0;
    for (const auto& [guid, each] : s.graph.participants()) fast += each.vendor == "010f" ? 1 : 0;
    int watched = 0;
    for (const auto& [guid, each] : s.graph.endpoints()) {
      watched += each.kind == ros2::EndpointKind::kPublisher && each.ros &&
                         each.visibility == ros2::Visibility::kWatched
                     ? 1
                     : 0;
    }
    return fast == 2 && watched == 2;
  }));
  ASSERT_TRUE(shm.End(SIGTERM));
  // Should its farewell be lost, its lease of 20 s must end first.
  EXPECT_TRUE(WaitForNodes({"/rips", "/udp"}) || WaitForNodes({"/rips", "/udp"}));
}

TEST_F(FastBusTest, AServiceIsThereForItsClientsWhileTheSensorWatches) {
  StartAgent();
  Child server("fastdds_peer", Arguments({"--node", "/server", "--serve", "/enable"}));
  ASSERT_TRUE(server.WaitFor("up"));
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    return s.graph.ServicesOf("/server") == std::vector<std::string>{"/enable"};
  }));
  Child client("fastdds_peer", Arguments({"--node", "/client", "--call", "/enable"}));
  EXPECT_TRUE(client.WaitFor("ready")) << testing::PrintToString(client.Lines());
  EXPECT_TRUE(client.WaitFor("reply"));
  EXPECT_TRUE(WaitForNodes({"/client", "/rips", "/server"}));
  EXPECT_EQ(client.Line("counts 2"), "") << "a reader of requests too many";
  // What the sensor must not do: one reader more, and a new client takes the service for absent.
  agent_->Stop();
  agent_.reset();
  const auto participant = *dds::Participant::Create({.id = dds::RandomDomain()});
  const auto bare = *dds::RawReader::Create(
      *participant, {.topic = "rq/enableRequest", .type = "std_srvs::srv::dds_::SetBool_Request_"},
      [](const dds::RawSample&) {});
  EXPECT_TRUE(client.WaitFor("counts 2 1"));
}

}  // namespace
}  // namespace rips::sensor

int main(int argc, char** argv) {
  rips::sensor::own_network = rips::bus::EnterOwnNetwork();
  testing::InitGoogleMock(&argc, argv);
  return RUN_ALL_TESTS();
}
