#include "sensor_agent/agent.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/fake_robot.h"
#include "sensor_agent/interest/interest_file.h"
#include "sensor_agent/uplink/fake_policy_server.h"
#include "services/base/ids.h"
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
  AgentTest()
      : dir_(std::filesystem::temp_directory_path() / absl::StrCat("rips-sensor-", NewId())) {
    std::filesystem::create_directories(dir_);
  }
  ~AgentTest() override {
    if (agent_ != nullptr) agent_->Stop();
    server_.Stop();
    EXPECT_THAT(server_.violations, IsEmpty());
    std::filesystem::remove_all(dir_);
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
                        .watch = {.observer_hidden = hidden, .settle = absl::Milliseconds(500)},
                        .state_dir = dir_.string()};
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

  // Only topics that match, as metadata. With the id that the server would give it.
  std::string AskOnlyFor(const std::string& regex) {
    rips::v1::SensorReply reply;
    rips::v1::InterestRule* rule = reply.mutable_interest()->add_rules();
    rule->set_topic_regex(regex);
    rule->set_depth(rips::v1::InterestRule::METADATA);
    reply.mutable_interest()->add_rules()->set_depth(rips::v1::InterestRule::NOTHING);
    const std::string id = InterestId(reply.interest());
    reply.mutable_interest()->set_id(id);
    server_.Send(reply);
    return id;
  }
  int Count(const std::function<bool(const Recorded&)>& counts) {
    int count = 0;
    EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
      for (const Recorded& each : s.received) count += counts(each) ? 1 : 0;
      return true;
    }));
    return count;
  }
  bool WaitForVisibility(const ros2::Guid& endpoint, ros2::Visibility visibility,
                         const std::string& why = "") {
    return server_.WaitUntil([&](const FakePolicyServer& s) {
      const ros2::Endpoint* found = s.graph.FindEndpoint(endpoint);
      return found != nullptr && found->visibility == visibility && found->why == why;
    });
  }

  const std::filesystem::path dir_;
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

TEST_F(AgentTest, WhatNobodyNeedsIsNotReadAndIsCountedAllTheSame) {
  auto talker = robot_.AddProcess();
  const ros2::Guid chatter = talker->AddWriter("rt/chatter").guid();
  const ros2::Guid camera = talker->AddWriter("rt/camera").guid();
  talker->Announce("talker");
  StartServer();
  StartAgent();
  ASSERT_TRUE(WaitForMessage(*talker, "/camera", "/talker"));
  ASSERT_TRUE(WaitForVisibility(camera, ros2::Visibility::kWatched));

  AskOnlyFor("^/chatter$");
  ASSERT_TRUE(WaitForVisibility(camera, ros2::Visibility::kNotNeeded));
  EXPECT_TRUE(Eventually([&] { return talker->MatchedReaders("rt/camera") == 0; }));
  EXPECT_EQ(talker->MatchedReaders("rt/chatter"), 1u);
  EXPECT_TRUE(WaitForVisibility(chatter, ros2::Visibility::kWatched));
  EXPECT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    return s.graph.FindTopic("/camera")->subscribers == std::vector<std::string>{"/rips"};
  }));
  // A topic that comes under the interest, also while the server is away.
  server_.Stop();
  auto late = robot_.AddProcess();
  late->AddWriter("rt/late");
  late->AddWriter("rt/chatter");
  late->Announce("late");
  EXPECT_TRUE(Eventually([&] { return late->MatchedReaders("rt/chatter") == 1; }));
  EXPECT_EQ(late->MatchedReaders("rt/late"), 0u);

  StartServer();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.hellos.size() == 2; }));
  ASSERT_TRUE(WaitForMessage(*late, "/chatter", "/late"));
  AskOnlyFor("^/camera$");
  ASSERT_TRUE(WaitForVisibility(camera, ros2::Visibility::kWatched));
  EXPECT_TRUE(WaitForMessage(*talker, "/camera", "/talker"));
  EXPECT_EQ(Count([](const Recorded& each) { return each.what.has_loss(); }), 0)
      << "what was not needed is no loss";
}

TEST_F(AgentTest, ALatchedMessageIsJudgedOnceHoweverOftenItsTopicIsReadAnew) {
  auto mapper = robot_.AddProcess();
  const ros2::Guid map =
      mapper->AddWriter("rt/map", {.reliable = true, .transient_local = true, .depth = 5}).guid();
  mapper->Announce("mapper");
  mapper->Publish("rt/map");
  mapper->Publish("rt/map");
  StartServer();
  StartAgent();
  std::vector<uint64_t> sequences;
  const auto come = [&sequences](size_t count) {
    return [&sequences, count](const FakePolicyServer& s) {
      sequences.clear();
      for (const Recorded& each : s.Distinct(MESSAGES)) {
        if (each.topic == "/map") sequences.push_back(each.what.message().writer_sequence());
      }
      return sequences.size() >= count;
    };
  };
  ASSERT_TRUE(server_.WaitUntil(come(2)));
  for (int round = 0; round < 2; ++round) {
    AskOnlyFor("^/none$");
    ASSERT_TRUE(WaitForVisibility(map, ros2::Visibility::kNotNeeded));
    ASSERT_TRUE(Eventually([&] { return mapper->MatchedReaders("rt/map") == 0; }));
    if (round == 1) mapper->Publish("rt/map");
    AskOnlyFor("^/map$");
    ASSERT_TRUE(WaitForVisibility(map, ros2::Visibility::kWatched));
    ASSERT_TRUE(Eventually([&] { return mapper->MatchedReaders("rt/map") == 1; }));
  }
  // Behind the history comes what shows that all of it has come.
  mapper->Publish("rt/map");
  ASSERT_TRUE(server_.WaitUntil(come(4)));
  EXPECT_THAT(sequences, ElementsAre(1, 2, 3, 4));
}

TEST_F(AgentTest, TheInterestOutlivesTheProcess) {
  StartServer();
  StartAgent();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  const std::string id = AskOnlyFor("^/chatter$");
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.interests_applied.size() == 1; }));
  agent_->Stop();
  agent_.reset();
  server_.Stop();

  StartAgent();
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/chatter");
  talker->AddWriter("rt/other");
  EXPECT_TRUE(Eventually([&] { return talker->MatchedReaders("rt/chatter") == 1; }));
  EXPECT_EQ(talker->MatchedReaders("rt/other"), 0u);
  StartServer();
  EXPECT_TRUE(server_.WaitUntil(
      [&](const FakePolicyServer& s) { return s.hellos.back().interest_in_use() == id; }));
}

TEST_F(AgentTest, WithACorruptInterestEverythingIsWatched) {
  std::ofstream(dir_ / "interest") << "no interest";
  StartServer();
  StartAgent();
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/other");
  talker->Announce("talker");
  EXPECT_TRUE(WaitForMessage(*talker, "/other", "/talker"));
  EXPECT_TRUE(server_.WaitUntil(
      [](const FakePolicyServer& s) { return s.hellos.back().interest_in_use().empty(); }));
}

TEST_F(AgentTest, RosoutIsReadOnlyIfItIsNamedAndNeverCounted) {
  auto talker = robot_.AddProcess();
  const ros2::Guid log = talker->AddWriter("rt/rosout").guid();
  talker->Announce("talker");
  StartServer();
  StartAgent();
  ASSERT_TRUE(WaitForVisibility(log, ros2::Visibility::kNotNeeded));
  const auto subscribers = [](const FakePolicyServer& s) {
    return s.graph.FindTopic("/rosout")->subscribers;
  };
  EXPECT_TRUE(server_.WaitUntil([&](const auto& s) { return subscribers(s).empty(); }));
  AskOnlyFor("^/rosout$");
  ASSERT_TRUE(WaitForVisibility(log, ros2::Visibility::kWatched));
  EXPECT_TRUE(WaitForMessage(*talker, "/rosout", "/talker"));
  EXPECT_TRUE(server_.WaitUntil([&](const auto& s) { return subscribers(s).empty(); }));
}

TEST_F(AgentTest, AWriterThatCannotBeReadIsShownWithItsReason) {
  auto process = robot_.AddProcess();
  const auto exclusive = dds::RawWriter::Create(
      process->participant(),
      {.topic = "rt/chatter", .type = "std_msgs::msg::dds_::String_", .exclusive = true});
  ASSERT_THAT(exclusive, IsOk());
  StartServer();
  StartAgent();
  EXPECT_TRUE(WaitForVisibility((*exclusive)->guid(), ros2::Visibility::kNotVisible,
                                "QoS: exclusive ownership"));
  AskOnlyFor("^/none$");
  EXPECT_TRUE(WaitForVisibility((*exclusive)->guid(), ros2::Visibility::kNotNeeded));
  AskOnlyFor("^/chatter$");
  EXPECT_TRUE(WaitForVisibility((*exclusive)->guid(), ros2::Visibility::kNotVisible,
                                "QoS: exclusive ownership"));
}

TEST_F(AgentTest, AHostThatIsNotPrimaryReadsNothingUntilItIs) {
  auto talker = robot_.AddProcess();
  talker->AddWriter("rt/chatter");
  talker->Announce("talker");
  server_.Set([](auto& b) { b.primary = false; });
  StartServer();
  StartAgent();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return !s.hellos.empty(); }));
  ASSERT_TRUE(Eventually(
      [&] { return metrics_.Text().find("rips_sensor_streaming 1") != std::string::npos; }));
  EXPECT_TRUE(Eventually([&] { return talker->MatchedReaders("rt/chatter") == 0; }));
  agent_->OnSignal("SIGUSR1");
  ASSERT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) {
    return !s.received.empty() && s.received.back().what.has_signal();
  })) << "what is of the host is told";
  EXPECT_EQ(Count([](const Recorded& each) {
              return each.what.has_message() || each.what.has_snapshot() || each.what.has_delta();
            }),
            0);

  server_.Stop();
  server_.Set([](auto& b) { b.primary = true; });
  StartServer();
  ASSERT_TRUE(WaitForPublisher("/chatter", "/talker"));
  EXPECT_TRUE(WaitForMessage(*talker, "/chatter", "/talker"));
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

TEST_F(AgentTest, ANameThatNoNodeCanHaveIsALossAndHidesNoOtherNodeOfItsProcess) {
  auto process = robot_.AddProcess();
  const ros2::Guid writer = process->AddWriter("rt/chatter").guid();
  StartServer();
  StartAgent();
  ASSERT_TRUE(server_.WaitUntil([](const auto& s) { return s.settled; }));
  process->AnnounceBytes(ros2::EncodeParticipantEntities(
      {.participant = process->participant().guid(),
       .nodes = {
           {.node_namespace = "/", .node_name = "a b", .readers = {}, .writers = {}},
           {.node_namespace = "/", .node_name = "sneaky", .readers = {}, .writers = {writer}}}}));
  ASSERT_TRUE(WaitForPublisher("/chatter", "/sneaky"));
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
  ~DaemonTest() override {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
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

// What systemd hears of it, with a server or without.
TEST_F(DaemonTest, NotifiesTheServiceManagerAndPingsWhileItWatches) {
  WriteConfig("r1");
  const std::string path = (dir_ / "notify").string();
  sockaddr_un address{.sun_family = AF_UNIX, .sun_path = {}};
  ASSERT_LT(path.size(), sizeof(address.sun_path));
  path.copy(address.sun_path, path.size());
  const UniqueFd receiver(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  ASSERT_EQ(bind(receiver.get(), reinterpret_cast<sockaddr*>(&address), sizeof(address)), 0);
  std::vector<std::string> heard;
  const auto hears = [&](const std::string& message) {
    return Eventually([&] {
      char buffer[4096];
      ssize_t size = 0;
      while ((size = recv(receiver.get(), buffer, sizeof(buffer), MSG_DONTWAIT)) > 0) {
        heard.emplace_back(buffer, size);
      }
      return std::any_of(heard.begin(), heard.end(),
                         [&](const auto& each) { return absl::StartsWith(each, message); });
    });
  };
  setenv("NOTIFY_SOCKET", path.c_str(), 1);
  setenv("WATCHDOG_USEC", "1000000", 1);
  Spawn();
  unsetenv("NOTIFY_SOCKET");
  unsetenv("WATCHDOG_USEC");
  EXPECT_TRUE(hears("READY=1")) << Output();
  EXPECT_TRUE(hears("STATUS=watching domain ")) << Output();
  EXPECT_TRUE(hears("WATCHDOG=1"));
  // A process that stands still is silent: what is heard from now on was sent before.
  kill(pid_, SIGSTOP);
  int status = 0;
  ASSERT_EQ(waitpid(pid_, &status, WUNTRACED), pid_);
  ASSERT_TRUE(WIFSTOPPED(status));
  EXPECT_TRUE(hears("READY=1"));
  heard.clear();
  kill(pid_, SIGCONT);
  EXPECT_TRUE(hears("WATCHDOG=1"));
  kill(pid_, SIGTERM);
  EXPECT_TRUE(hears("STOPPING=1"));
  EXPECT_EQ(WaitForExit(), 0) << Output();
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

TEST_F(DaemonTest, CheckConfigNamesAMissingFileOfTheKeystore) {
  WriteConfig("r1");
  std::ostringstream text;
  text << std::ifstream(dir_ / "sensor.yaml").rdbuf();
  const std::string keystore = (dir_ / "keystore").string();
  std::ofstream(dir_ / "sensor.yaml") << absl::StrReplaceAll(
      text.str(), {{"interface: lo",
                    absl::StrCat("security: {keystore: ", keystore, ", enclave: /rips/sensor}")}});
  Spawn({"--check-config"});
  EXPECT_EQ(WaitForExit(), 2);
  EXPECT_THAT(Output(),
              HasSubstr(absl::StrCat(keystore, "/enclaves/rips/sensor/identity_ca.cert.pem")));
}

TEST_F(DaemonTest, CheckConfigNamesMissingDirectories) {
  WriteConfig("r1", "outbox: {dir: /no/such/spool}\n");
  Spawn({"--check-config"});
  EXPECT_EQ(WaitForExit(), 2);
  EXPECT_THAT(Output(), HasSubstr("`outbox.dir` needs the directory `/no/such`, which does not"));
}

TEST_F(DaemonTest, CheckConfigPrintsTheEffectiveConfiguration) {
  WriteConfig("r1");
  Spawn({"--check-config"});
  EXPECT_EQ(WaitForExit(), 0);
  EXPECT_THAT(Output(), HasSubstr("attribution_grace: 500ms"));
}

}  // namespace
}  // namespace rips::sensor
