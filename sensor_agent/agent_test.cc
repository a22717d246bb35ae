#include "sensor_agent/agent.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/fake_policy_server.h"
#include "sensor_agent/fake_robot.h"
#include "services/base/status_matchers.h"
#include "services/rpc/credentials.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"

namespace rips::sensor {
namespace {

using dds::Eventually;
using rips::v1::CONTROL;
using rips::v1::MESSAGES;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::StartsWith;

class AgentTest : public testing::Test {
 protected:
  ~AgentTest() override {
    if (agent_ != nullptr) agent_->Stop();
    server_.Stop();
    EXPECT_THAT(server_.violations, IsEmpty());
  }

  void StartServer() {
    const auto credentials = rpc::Credentials::Load(pki_.Server());
    ASSERT_THAT(credentials, IsOk());
    server_.Start((*credentials)->ForServer());
  }
  void StartAgent(bool hidden = false) {
    SensorConfig config{.robot = "r1",
                        .host = "base",
                        .servers = {server_.address()},
                        .dds = {.domain = dds::RandomDomain(), .interface = "lo"},
                        .observer_hidden = hidden,
                        .settle = absl::Milliseconds(500)};
    const auto credentials = rpc::Credentials::Load(pki_.Sensor());
    ASSERT_THAT(credentials, IsOk());
    auto agent = Agent::Create(config, (*credentials)->ForClient(), &clock_, &metrics_);
    ASSERT_THAT(agent, IsOk());
    agent_ = *std::move(agent);
    agent_->Start();
  }
  static std::vector<std::string> Publishers(const FakePolicyServer& server,
                                             const std::string& topic) {
    const ros2::Topic* found = server.graph.FindTopic(topic);
    return found == nullptr ? std::vector<std::string>{} : found->publishers;
  }
  bool WaitForPublisher(const std::string& topic, const std::string& publisher) {
    return server_.WaitUntil([&](const FakePolicyServer& s) {
      return testing::Matches(Contains(StartsWith(publisher)))(Publishers(s, topic));
    });
  }
  // Publishes until the server has a message of `topic` whose writer is of `node`.
  bool WaitForMessage(FakeProcess& process, const std::string& topic, const std::string& node) {
    return server_.WaitUntil([&](const FakePolicyServer& s) {
      process.Publish(absl::StrCat("rt", topic));
      for (const Recorded& each : s.received) {
        if (each.lane == MESSAGES && each.topic == topic && each.writer.node() == node) {
          return true;
        }
      }
      return false;
    });
  }

  // Asks for the first bytes of the messages of topics that match.
  void Ask(char id, const std::string& regex, uint32_t bytes) {
    rips::v1::SensorReply reply;
    reply.mutable_interest()->set_id(std::string(kInterestIdBytes, id));
    rips::v1::InterestRule* rule = reply.mutable_interest()->add_rules();
    rule->set_topic_regex(regex);
    rule->set_depth(rips::v1::InterestRule::PAYLOAD);
    rule->set_payload_bytes_max(bytes);
    reply.mutable_interest()->add_rules()->set_depth(rips::v1::InterestRule::METADATA);
    server_.Send(reply);
  }
  // That of the newest message of `topic`.
  std::string PayloadOf(const std::string& topic) {
    std::string payload;
    EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
      for (const Recorded& each : s.received) {
        if (each.topic == topic && each.what.has_message()) payload = each.what.message().payload();
      }
      return true;
    }));
    return payload;
  }
  // Publishes until a new message of `topic` comes with that payload.
  bool WaitForPayload(FakeProcess& process, const std::string& topic, const std::string& payload) {
    std::optional<size_t> before;
    return server_.WaitUntil([&](const FakePolicyServer& s) {
      if (!before.has_value()) before = s.received.size();
      process.Publish(absl::StrCat("rt", topic));
      for (size_t i = *before; i < s.received.size(); ++i) {
        const Recorded& each = s.received[i];
        if (each.topic == topic && each.what.has_message() &&
            each.what.message().payload() == payload) {
          return true;
        }
      }
      return false;
    });
  }

  rpc::TestPki pki_;
  const RealClock clock_;
  Metrics metrics_;
  FakeRobot robot_;
  FakePolicyServer server_;
  std::unique_ptr<Agent> agent_;
};

TEST_F(AgentTest, ReportsNodesTopicsAndAttributedMessages) {
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/chatter");
  talker->Announce("talker");
  auto jazzy = robot_.AddProcess();
  jazzy->AddWriter("rt/map", {.reliable = true, .transient_local = true, .depth = 1});
  jazzy->Announce("mapper", ros2::GidBytes::k16);
  jazzy->Publish("rt/map");
  StartServer();
  StartAgent();

  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  ASSERT_TRUE(WaitForPublisher("/chatter", "/talker"));
  ASSERT_TRUE(WaitForPublisher("/map", "/mapper"));
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    return testing::Matches(ElementsAre("/rips"))(s.graph.FindTopic("/chatter")->subscribers) &&
           testing::Matches(ElementsAre("std_msgs/msg/String"))(
               s.graph.FindTopic("/chatter")->types);
  }));
  EXPECT_TRUE(WaitForMessage(*talker, "/chatter", "/talker"));
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    for (const Recorded& each : s.received) {
      if (each.topic == "/map" && each.writer.node() == "/mapper") return true;
    }
    return false;
  })) << "what was latched before we came";
}

TEST_F(AgentTest, IntruderIsSeenWithItsMessagesAndLeaves) {
  auto base = robot_.AddProcess();
  base->AddWriter("rt/cmd_vel");
  base->Announce("base");
  StartServer();
  StartAgent();
  ASSERT_TRUE(WaitForPublisher("/cmd_vel", "/base"));

  auto intruder = robot_.AddProcess();
  const ros2::Guid guid = intruder->AddWriter("rt/cmd_vel").guid();
  ASSERT_TRUE(WaitForMessage(*intruder, "/cmd_vel", ""));
  ASSERT_TRUE(WaitForPublisher("/cmd_vel", absl::StrCat("(unattributed ", ToString(guid))));
  // It tries to pass for the base by claiming the base's node and its writer.
  intruder->Announce("evil", ros2::GidBytes::k24, {base->participant().guid()});
  ASSERT_TRUE(WaitForPublisher("/cmd_vel", "/evil"));
  EXPECT_TRUE(WaitForMessage(*intruder, "/cmd_vel", "/evil"));

  intruder.reset();
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    return testing::Matches(ElementsAre("/base"))(Publishers(s, "/cmd_vel"));
  }));
}

TEST_F(AgentTest, GoesOnAfterTheServerWasAway) {
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/chatter");
  talker->Announce("talker");
  StartServer();
  StartAgent();
  ASSERT_TRUE(WaitForPublisher("/chatter", "/talker"));
  ASSERT_TRUE(WaitForMessage(*talker, "/chatter", "/talker"));
  server_.Stop();
  auto late = robot_.AddProcess();
  late->AddWriter("rt/late");
  late->Announce("late");
  server_.Set([](auto& b) { b.forget = true; });
  StartServer();
  EXPECT_TRUE(WaitForPublisher("/late", "/late"));
  EXPECT_TRUE(WaitForPublisher("/chatter", "/talker"));
  EXPECT_TRUE(WaitForMessage(*late, "/late", "/late"));
}

TEST_F(AgentTest, PayloadsComeForTheTopicsAskedForAndNoOthers) {
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/chatter");
  talker->AddWriter("rt/camera");
  talker->Announce("talker");
  StartServer();
  StartAgent();
  ASSERT_TRUE(WaitForMessage(*talker, "/chatter", "/talker"));
  ASSERT_TRUE(WaitForMessage(*talker, "/camera", "/talker"));
  EXPECT_EQ(PayloadOf("/chatter"), "") << "nobody has asked";

  // Header, length, six characters and padding.
  const std::string whole("\0\1\0\0\6\0\0\0hello\0\0\0", 16);
  Ask('a', "^/chatter$", 10);
  ASSERT_TRUE(WaitForPayload(*talker, "/chatter", whole.substr(0, 10)));
  ASSERT_TRUE(WaitForMessage(*talker, "/camera", "/talker"));
  EXPECT_EQ(PayloadOf("/camera"), "");

  Ask('b', "(", 10);
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.interests_applied.size() == 2; }));
  ASSERT_TRUE(WaitForPayload(*talker, "/chatter", whole.substr(0, 10))) << "the one before stays";

  Ask('c', "^/cam", 65'536);
  ASSERT_TRUE(WaitForPayload(*talker, "/camera", whole));
  ASSERT_TRUE(WaitForPayload(*talker, "/chatter", ""));

  server_.Stop();
  StartServer();
  ASSERT_TRUE(WaitForPayload(*talker, "/camera", whole)) << "without being told again";
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    return s.hellos.back().interest_in_use() == std::string(kInterestIdBytes, 'c') &&
           s.interests_applied.size() == 3 && s.interests_applied[0].problem().empty() &&
           !s.interests_applied[1].problem().empty() && s.interests_applied[2].problem().empty();
  }));
}

TEST_F(AgentTest, HiddenObserverIsNotInTheGraph) {
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/chatter");
  talker->Announce("talker");
  StartServer();
  StartAgent(/*hidden=*/true);
  ASSERT_TRUE(WaitForPublisher("/chatter", "/talker"));
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    return s.graph.FindTopic("/chatter")->subscribers.empty();
  }));
  EXPECT_TRUE(WaitForMessage(*talker, "/chatter", "/talker")) << "hidden, not blind";
}

TEST_F(AgentTest, UndecodableClaimIsALoss) {
  auto process = robot_.AddProcess();
  StartServer();
  StartAgent();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  process->AnnounceBytes(std::string("\0\1\0\0\xff\xff\xff", 7));
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    for (const Recorded& each : s.Distinct(CONTROL)) {
      if (each.what.loss().cause() == rips::v1::Loss::UNDECODABLE) return true;
    }
    return false;
  }));
}

// --- The daemon as a process

class DaemonTest : public AgentTest {
 protected:
  DaemonTest() {
    dir_ = std::filesystem::temp_directory_path() / absl::StrCat("rips-sensor-", getpid());
    std::filesystem::create_directories(dir_);
  }
  ~DaemonTest() override {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
    std::filesystem::remove_all(dir_);
  }

  void WriteConfig(const std::string& robot, const std::string& more = "") {
    const TlsFiles tls = pki_.Sensor();
    std::ofstream(dir_ / "sensor.yaml")
        << "robot: " << robot << "\nhost: base\nservers: [\"127.0.0.1:1\"]\n"
        << "tls: {ca: " << tls.ca << ", cert: " << tls.cert << ", key: " << tls.key << "}\n"
        << "dds: {domain: " << dds::RandomDomain() << ", interface: lo}\n"
        << "metrics: \"127.0.0.1:0\"\n"
        << more << "state_dir: " << dir_.string() << "\n";
  }
  void Spawn(std::vector<std::string> more = {}) {
    std::vector<std::string> arguments = {absl::StrCat(RIPS_BIN_DIR, "/rips-sensor"), "--config",
                                          (dir_ / "sensor.yaml").string()};
    arguments.insert(arguments.end(), more.begin(), more.end());
    std::vector<char*> argv;
    for (std::string& each : arguments) argv.push_back(each.data());
    argv.push_back(nullptr);
    const std::string output = (dir_ / "output").string();
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, 1, output.c_str(), O_CREAT | O_WRONLY | O_APPEND,
                                     0600);
    posix_spawn_file_actions_adddup2(&actions, 1, 2);
    ASSERT_EQ(posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ), 0);
    posix_spawn_file_actions_destroy(&actions);
  }
  // The exit code; -1 if it was killed or does not end.
  int WaitForExit() {
    int status = 0;
    if (!Eventually([&] { return waitpid(pid_, &status, WNOHANG) == pid_; })) return -1;
    pid_ = 0;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  std::string Output() {
    std::ostringstream text;
    text << std::ifstream(dir_ / "output").rdbuf();
    return text.str();
  }

  std::filesystem::path dir_;
  pid_t pid_ = 0;
};

TEST_F(DaemonTest, RunsWithoutAServerAndEndsCleanlyOnSigterm) {
  WriteConfig("r1");
  const std::string ready = (dir_ / "ready").string();
  Spawn({"--ready-file", ready});
  ASSERT_TRUE(Eventually([&] { return std::filesystem::exists(ready); })) << Output();
  ASSERT_EQ(kill(pid_, SIGUSR1), 0);
  ASSERT_EQ(kill(pid_, SIGTERM), 0);
  EXPECT_EQ(WaitForExit(), 0) << Output();
  EXPECT_THAT(Output(), HasSubstr("listening address=127.0.0.1:"));
}

TEST_F(DaemonTest, CertificateOfAnotherRobotEndsWithTwo) {
  WriteConfig("r2");
  Spawn();
  EXPECT_EQ(WaitForExit(), 2);
  EXPECT_THAT(Output(), HasSubstr("use the certificate of this sensor"));
}

TEST_F(DaemonTest, UnknownKeyEndsWithTwoAndItsPlace) {
  WriteConfig("r1", "setle: 2s\n");
  Spawn();
  EXPECT_EQ(WaitForExit(), 2);
  EXPECT_THAT(Output(), HasSubstr("sensor.yaml:7:1: unknown key `setle`"));
}

TEST_F(DaemonTest, CheckConfigPrintsTheEffectiveConfiguration) {
  WriteConfig("r1");
  Spawn({"--check-config"});
  EXPECT_EQ(WaitForExit(), 0);
  EXPECT_THAT(Output(), HasSubstr("attribution_grace: 500ms"));
}

}  // namespace
}  // namespace rips::sensor
