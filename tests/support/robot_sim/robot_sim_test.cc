// The simulator as others meet it: a process of its own, seen over DDS.
#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <map>
#include <memory>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "services/base/status_matchers.h"
#include "services/dds/discovery.h"
#include "services/dds/participant.h"
#include "services/dds/raw_reader.h"
#include "services/dds/service_client.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/parameter_messages.h"
#include "services/ros2/ros_name.h"
#include "services/ros2/system_modes_messages.h"
#include "services/runtime/mutex.h"
#include "tests/support/robot_sim/ros_messages.h"
#include "tests/support/ros2/server_messages.h"

extern char** environ;

namespace rips::robot_sim {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::UnorderedElementsAre;

// Generous: the machine may be busy. Nothing waits for so long when all is well.
constexpr absl::Duration kPatience = absl::Seconds(20);
// How far from its rate a publisher may be, as a multiple; a sanitizer takes most of the machine.
#ifdef RIPS_SANITIZED
constexpr double kSlack = 3;
#else
constexpr double kSlack = 1;
#endif

// A domain for one test, its process and its children: others who happen to use the same number at
// the same time have another tag. Above 100, ports lie where Linux gives them to others.
uint32_t OwnDomain() {
  static uint32_t next = [] {
    std::random_device random;
    const std::string xml = absl::StrCat(
        "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" "
        "multicast=\"true\"/></Interfaces></General><Discovery><Tag>robot-sim-",
        random(), "-", random(),
        "</Tag><ParticipantIndex>none</ParticipantIndex></Discovery></Domain></CycloneDDS>");
    setenv("CYCLONEDDS_URI", xml.c_str(), /*overwrite=*/1);
    return std::uniform_int_distribution<uint32_t>(0, 89)(random);
  }();
  return 10 + next++ % 90;
}

// Polls until `done` or kPatience is over. True if it was done.
template <typename Done>
bool Eventually(Done done) {
  const absl::Time deadline = absl::Now() + kPatience;
  while (!done()) {
    if (absl::Now() > deadline) {
      return false;
    }
    absl::SleepFor(absl::Milliseconds(10));
  }
  return true;
}

// `robot_sim` with these arguments; its stdout is read as JSON lines.
class Simulator {
 public:
  explicit Simulator(std::vector<std::string> args) {
    args.insert(args.begin(), absl::StrCat(RIPS_BIN_DIR, "/robot_sim"));
    std::vector<char*> argv;
    for (std::string& arg : args) {
      argv.push_back(arg.data());
    }
    argv.push_back(nullptr);
    int fds[2];
    EXPECT_EQ(pipe2(fds, O_CLOEXEC), 0);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, fds[1], STDOUT_FILENO);
    EXPECT_EQ(posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ), 0) << argv[0];
    posix_spawn_file_actions_destroy(&actions);
    close(fds[1]);
    out_ = fds[0];
  }
  ~Simulator() {
    if (pid_ > 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
    close(out_);
  }
  Simulator(const Simulator&) = delete;
  Simulator& operator=(const Simulator&) = delete;

  // The next line whose "event" is `event`; others are skipped. An empty object if none came.
  nlohmann::json Await(const std::string& event) {
    const absl::Time deadline = absl::Now() + kPatience;
    while (std::optional<std::string> line = NextLine(deadline)) {
      nlohmann::json json = nlohmann::json::parse(*line, nullptr, false);
      EXPECT_FALSE(json.is_discarded()) << *line;
      if (json.value("event", "") == event) {
        return json;
      }
    }
    ADD_FAILURE() << "no event `" << event << "`";
    return nlohmann::json::object();
  }

  // Sends SIGTERM (if `signal`) and gives the exit code; -1 if it did not end in time.
  int Finish(bool signal) {
    if (signal) {
      kill(pid_, SIGTERM);
    }
    int status = 0;
    if (!Eventually([&] { return waitpid(pid_, &status, WNOHANG) == pid_; })) {
      return -1;
    }
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }

 private:
  std::optional<std::string> NextLine(absl::Time deadline) {
    for (;;) {
      const size_t end = buffer_.find('\n');
      if (end != std::string::npos) {
        std::string line = buffer_.substr(0, end);
        buffer_.erase(0, end + 1);
        return line;
      }
      pollfd poll_fd = {.fd = out_, .events = POLLIN, .revents = 0};
      const int64_t left_ms = absl::ToInt64Milliseconds(deadline - absl::Now());
      if (left_ms <= 0 || poll(&poll_fd, 1, static_cast<int>(left_ms)) <= 0) {
        return std::nullopt;
      }
      char chunk[4096];
      const ssize_t size = read(out_, chunk, sizeof chunk);
      if (size <= 0) {
        return std::nullopt;
      }
      buffer_.append(chunk, static_cast<size_t>(size));
    }
  }

  pid_t pid_ = -1;
  int out_ = -1;
  std::string buffer_;
};

// What an outsider gathers from a domain: endpoints, and the last discovery message per writer.
class Observer {
 public:
  explicit Observer(uint32_t domain) {
    auto participant = dds::Participant::Create(dds::DomainOptions{domain, "lo"});
    EXPECT_THAT(participant, IsOk());
    participant_ = *std::move(participant);
    auto discovery =
        dds::Discovery::Create(*participant_, {.on_participant =
                                                   [this](const dds::ParticipantSeen& seen) {
                                                     MutexLock lock(&mu_);
                                                     if (seen.alive) {
                                                       participants_[seen.guid] = seen;
                                                     } else {
                                                       participants_.erase(seen.guid);
                                                     }
                                                   },
                                               .on_endpoint =
                                                   [this](const dds::EndpointSeen& seen) {
                                                     MutexLock lock(&mu_);
                                                     if (seen.alive) {
                                                       endpoints_[seen.guid] = seen;
                                                     } else {
                                                       endpoints_.erase(seen.guid);
                                                     }
                                                   }});
    EXPECT_THAT(discovery, IsOk());
    discovery_ = *std::move(discovery);
    auto reader =
        dds::RawReader::Create(*participant_,
                               {.topic = ros2::kDiscoveryTopic,
                                .type = ros2::kDiscoveryType,
                                .reliable_transient_local = true,
                                .keep_all = true},
                               [this](const dds::RawSample& sample) {
                                 MutexLock lock(&mu_);
                                 auto info = ros2::DecodeParticipantEntities(sample.payload);
                                 if (info.ok() && ros2::CheckOrigin(*info, sample.writer).ok()) {
                                   infos_[sample.writer] = *std::move(info);
                                 } else {
                                   ++refused_;
                                 }
                               });
    EXPECT_THAT(reader, IsOk());
    reader_ = *std::move(reader);
  }

  // Full names of the nodes announced so far.
  std::vector<std::string> Nodes() const {
    MutexLock lock(&mu_);
    std::vector<std::string> names;
    for (const auto& [writer, info] : infos_) {
      for (const ros2::NodeEntities& node : info.nodes) {
        names.push_back(ros2::JoinNodeName(node.node_namespace, node.node_name));
      }
    }
    return names;
  }
  // Endpoints of others than this observer.
  std::vector<dds::EndpointSeen> Endpoints() const {
    MutexLock lock(&mu_);
    std::vector<dds::EndpointSeen> endpoints;
    for (const auto& [guid, endpoint] : endpoints_) {
      if (!guid.SamePrefix(participant_->guid())) {
        endpoints.push_back(endpoint);
      }
    }
    return endpoints;
  }
  std::optional<dds::EndpointSeen> Find(const std::string& topic, bool writer) const {
    for (const dds::EndpointSeen& endpoint : Endpoints()) {
      if (endpoint.topic == topic && endpoint.writer == writer) {
        return endpoint;
      }
    }
    return std::nullopt;
  }
  std::vector<ros2::ParticipantEntities> Infos() const {
    MutexLock lock(&mu_);
    std::vector<ros2::ParticipantEntities> infos;
    for (const auto& [writer, info] : infos_) {
      infos.push_back(info);
    }
    return infos;
  }
  std::vector<dds::ParticipantSeen> Participants() const {
    MutexLock lock(&mu_);
    std::vector<dds::ParticipantSeen> participants;
    for (const auto& [guid, seen] : participants_) {
      if (guid != participant_->guid()) {
        participants.push_back(seen);
      }
    }
    return participants;
  }
  size_t refused() const {
    MutexLock lock(&mu_);
    return refused_;
  }
  const dds::Participant& participant() const { return *participant_; }

  // Calls a service of the robot once.
  absl::StatusOr<std::string> Call(const std::string& service, const std::string& type,
                                   const std::string& request) {
    auto& client = clients_[service];
    if (client == nullptr) {
      auto created = dds::ServiceClient::Create(*participant_, {service, type});
      if (!created.ok()) {
        return created.status();
      }
      client = *std::move(created);
    }
    return client->Call(request, kPatience);
  }
  bool ChangeMode(const std::string& part, const std::string& mode) {
    const auto reply = Call(absl::StrCat(part, "/change_mode"), ros2::kChangeModeType,
                            ros2::EncodeChangeModeRequest(mode));
    EXPECT_THAT(reply, IsOk());
    return reply.ok() && ros2::DecodeSuccessReply(*reply).value_or(false);
  }
  std::string Mode(const std::string& part) {
    const auto reply =
        Call(absl::StrCat(part, "/get_mode"), ros2::kGetModeType, ros2::EncodeEmptyRequest());
    return reply.ok() ? ros2::DecodeGetModeReply(*reply).value_or("?") : "?";
  }
  uint8_t State(const std::string& part) {
    const auto reply =
        Call(absl::StrCat(part, "/get_state"), ros2::kGetStateType, ros2::EncodeEmptyRequest());
    const auto state = ros2::DecodeGetStateReply(reply.value_or(""));
    return state.ok() ? state->id : 255;
  }
  std::vector<ros2::ParameterValue> Parameters(const std::string& node,
                                               const std::vector<std::string>& names) {
    const auto reply = Call(absl::StrCat(node, "/get_parameters"), ros2::kGetParametersType,
                            ros2::EncodeGetParametersRequest(names));
    const auto values = ros2::DecodeGetParametersReply(reply.value_or(""));
    EXPECT_THAT(values, IsOk());
    return values.value_or(std::vector<ros2::ParameterValue>());
  }

 private:
  mutable Mutex mu_;
  std::map<ros2::Guid, dds::ParticipantSeen> participants_;
  std::map<ros2::Guid, dds::EndpointSeen> endpoints_;
  std::map<ros2::Guid, ros2::ParticipantEntities> infos_;
  size_t refused_ = 0;
  std::unique_ptr<dds::Participant> participant_;
  std::unique_ptr<dds::Discovery> discovery_;
  std::unique_ptr<dds::RawReader> reader_;
  std::map<std::string, std::unique_ptr<dds::ServiceClient>> clients_;
};

// Counts the samples of one topic and keeps the last.
class Listener {
 public:
  Listener(const dds::Participant& participant, const std::string& topic, const std::string& type) {
    auto reader = dds::RawReader::Create(
        participant, {.topic = ros2::MangleTopic(topic), .type = ros2::MangleType(type)},
        [this](const dds::RawSample& sample) {
          MutexLock lock(&mu_);
          ++count_;
          last_ = std::string(sample.payload);
          last_received_ = absl::Now();
        });
    EXPECT_THAT(reader, IsOk());
    reader_ = *std::move(reader);
  }
  size_t count() const {
    MutexLock lock(&mu_);
    return count_;
  }
  std::string last() const {
    MutexLock lock(&mu_);
    return last_;
  }
  // Nothing came for so long.
  bool QuietFor(absl::Duration duration) const {
    MutexLock lock(&mu_);
    return absl::Now() - last_received_ > duration;
  }
  // Samples per second over `window`, once samples come.
  double Rate(absl::Duration window) const {
    const size_t before = count();
    EXPECT_TRUE(Eventually([&] { return count() > before; }));
    const size_t start = count();
    const absl::Time start_time = absl::Now();
    EXPECT_TRUE(Eventually([&] { return absl::Now() - start_time >= window; }));
    return static_cast<double>(count() - start) / absl::ToDoubleSeconds(absl::Now() - start_time);
  }

 private:
  mutable Mutex mu_;
  size_t count_ = 0;
  std::string last_;
  absl::Time last_received_ = absl::InfinitePast();
  std::unique_ptr<dds::RawReader> reader_;
};

class RobotSimTest : public ::testing::Test {
 protected:
  std::unique_ptr<Simulator> Start(std::vector<std::string> args) {
    args.insert(args.begin() + 1, {"--domain", std::to_string(domain_)});
    return std::make_unique<Simulator>(std::move(args));
  }
  std::unique_ptr<Simulator> StartRobot(std::vector<std::string> more = {}) {
    std::vector<std::string> args = {"robot", "--smh", kSmh};
    args.insert(args.end(), more.begin(), more.end());
    std::unique_ptr<Simulator> robot = Start(std::move(args));
    EXPECT_EQ(robot->Await("ready").value("mode", ""), "__DEFAULT__");
    return robot;
  }

  static constexpr char kSmh[] = RIPS_SOURCE_DIR "/tests/support/robot_sim/smh.yaml";
  const uint32_t domain_ = OwnDomain();
};

TEST_F(RobotSimTest, AnnouncesItsNodesAndEveryEndpointBelongsToOne) {
  const auto robot = StartRobot();
  Observer observer(domain_);

  EXPECT_TRUE(Eventually([&] { return observer.Nodes().size() == 5; }));
  EXPECT_THAT(observer.Nodes(),
              UnorderedElementsAre("/base", "/camera", "/lidar", "/navigator", "/safety"));
  EXPECT_EQ(observer.refused(), 0U);
  for (const dds::ParticipantSeen& participant : observer.Participants()) {
    EXPECT_EQ(participant.enclave, "/");
    EXPECT_EQ(participant.vendor, "0110");
  }
  std::set<ros2::Guid> owned;
  for (const ros2::ParticipantEntities& info : observer.Infos()) {
    EXPECT_EQ(info.gid_bytes, ros2::GidBytes::k24);
    for (const ros2::NodeEntities& node : info.nodes) {
      owned.insert(node.readers.begin(), node.readers.end());
      owned.insert(node.writers.begin(), node.writers.end());
    }
  }
  const auto all_seen = [&] {
    std::set<ros2::Guid> seen;
    for (const dds::EndpointSeen& endpoint : observer.Endpoints()) {
      if (endpoint.topic != ros2::kDiscoveryTopic) {
        seen.insert(endpoint.guid);
      }
    }
    return seen == owned;
  };
  EXPECT_TRUE(Eventually(all_seen)) << owned.size() << " endpoints listed";
}

// Topic, type and QoS as recorded from ROS 2 Humble over rmw_cyclonedds.
TEST_F(RobotSimTest, EndpointsLookAsRecorded) {
  struct Expected {
    std::string topic;
    bool writer;
    std::string type;
    bool reliable;
    bool transient_local;
  };
  const std::vector<Expected> table = {
      {"ros_discovery_info", true, "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_", true,
       true},
      {"ros_discovery_info", false, "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_", true,
       true},
      {"rt/rosout", true, "rcl_interfaces::msg::dds_::Log_", true, true},
      {"rt/parameter_events", true, "rcl_interfaces::msg::dds_::ParameterEvent_", true, false},
      {"rt/parameter_events", false, "rcl_interfaces::msg::dds_::ParameterEvent_", true, false},
      {"rq/camera/get_parametersRequest", false,
       "rcl_interfaces::srv::dds_::GetParameters_Request_", true, false},
      {"rr/camera/get_parametersReply", true, "rcl_interfaces::srv::dds_::GetParameters_Response_",
       true, false},
      {"rq/camera/set_parametersRequest", false,
       "rcl_interfaces::srv::dds_::SetParameters_Request_", true, false},
      {"rq/safety/change_modeRequest", false, "system_modes_msgs::srv::dds_::ChangeMode_Request_",
       true, false},
      {"rr/safety/change_modeReply", true, "system_modes_msgs::srv::dds_::ChangeMode_Response_",
       true, false},
      {"rq/camera/get_modeRequest", false, "system_modes_msgs::srv::dds_::GetMode_Request_", true,
       false},
      {"rr/camera/get_stateReply", true, "lifecycle_msgs::srv::dds_::GetState_Response_", true,
       false},
      {"rt/safety/mode_event", true, "system_modes_msgs::msg::dds_::ModeEvent_", true, false},
      {"rt/camera/transition_event", true, "lifecycle_msgs::msg::dds_::TransitionEvent_", true,
       false},
      {"rt/camera/image_raw", true, "sensor_msgs::msg::dds_::Image_", false, false},
      {"rt/scan", true, "sensor_msgs::msg::dds_::LaserScan_", false, false},
      {"rt/odom", true, "nav_msgs::msg::dds_::Odometry_", true, false},
      {"rt/cmd_vel", true, "geometry_msgs::msg::dds_::Twist_", true, false},
      {"rt/cmd_vel", false, "geometry_msgs::msg::dds_::Twist_", true, false},
  };
  const auto robot = StartRobot();
  Observer observer(domain_);

  for (const Expected& expected : table) {
    SCOPED_TRACE(absl::StrCat(expected.topic, expected.writer ? " writer" : " reader"));
    EXPECT_TRUE(Eventually([&] { return observer.Find(expected.topic, expected.writer); }));
    const dds::EndpointSeen seen =
        observer.Find(expected.topic, expected.writer).value_or(dds::EndpointSeen());
    EXPECT_EQ(seen.type, expected.type);
    EXPECT_EQ(seen.qos.reliable, expected.reliable);
    EXPECT_EQ(seen.qos.transient_local, expected.transient_local);
    EXPECT_EQ(seen.qos.partitions, std::vector<std::string>());
    const bool service =
        absl::StartsWith(expected.topic, "rq/") || absl::StartsWith(expected.topic, "rr/");
    EXPECT_EQ(absl::StartsWith(seen.user_data, "serviceid="), service) << seen.user_data;
  }
  EXPECT_EQ(observer.Find("rt/camera/image_raw", true)->qos.depth, 5U);
}

TEST_F(RobotSimTest, PublishesAtItsRates) {
  const auto robot = StartRobot();
  Observer observer(domain_);
  const Listener camera(observer.participant(), "/camera/image_raw", "sensor_msgs/msg/Image");
  const Listener scan(observer.participant(), "/scan", "sensor_msgs/msg/LaserScan");
  const Listener odom(observer.participant(), "/odom", "nav_msgs/msg/Odometry");

  EXPECT_NEAR(camera.Rate(absl::Seconds(2)), 15, 2 * kSlack);
  EXPECT_NEAR(scan.Rate(absl::Seconds(1)), 10, 2 * kSlack);
  EXPECT_NEAR(odom.Rate(absl::Seconds(1)), 20, 3 * kSlack);
}

TEST_F(RobotSimTest, ModesSwitchThePublishers) {
  const auto robot = StartRobot();
  Observer observer(domain_);
  const Listener camera(observer.participant(), "/camera/image_raw", "sensor_msgs/msg/Image");
  const Listener command(observer.participant(), "/cmd_vel", "geometry_msgs/msg/Twist");
  EXPECT_TRUE(Eventually([&] { return camera.count() > 0 && command.count() > 0; }));
  EXPECT_DOUBLE_EQ(DecodeTwist(command.last())->linear_x, 0.8);

  EXPECT_TRUE(observer.ChangeMode("/safety", "ALERT"));
  EXPECT_EQ(robot->Await("mode").value("mode", ""), "ALERT");
  EXPECT_EQ(observer.Mode("/safety"), "ALERT");
  EXPECT_EQ(observer.State("/safety"), 3);
  EXPECT_EQ(observer.State("/camera"), 2);
  EXPECT_EQ(observer.State("/navigator"), 3);
  EXPECT_EQ(observer.Mode("/navigator"), "SLOW");
  EXPECT_THAT(observer.Parameters("/navigator", {"max_speed", "controller"}),
              ElementsAre(ros2::ParameterValue(0.2), ros2::ParameterValue(std::string("pursuit"))));
  EXPECT_THAT(observer.Parameters("/navigator", {"max_speed", "nothing"}), ElementsAre());
  EXPECT_TRUE(Eventually([&] { return camera.QuietFor(absl::Milliseconds(400)); }));
  EXPECT_TRUE(Eventually([&] { return DecodeTwist(command.last())->linear_x < 0.2; }));

  EXPECT_TRUE(observer.ChangeMode("/safety", "COMPROMISED"));
  EXPECT_EQ(robot->Await("mode").value("mode", ""), "COMPROMISED");
  EXPECT_TRUE(Eventually([&] { return command.QuietFor(absl::Milliseconds(500)); }));

  EXPECT_FALSE(observer.ChangeMode("/safety", "NO_SUCH_MODE"));
  EXPECT_EQ(observer.Mode("/safety"), "COMPROMISED");

  EXPECT_TRUE(observer.ChangeMode("/safety", "__DEFAULT__"));
  EXPECT_EQ(robot->Await("mode").value("mode", ""), "__DEFAULT__");
  const size_t before = camera.count();
  EXPECT_TRUE(Eventually([&] { return camera.count() > before; }));
}

TEST_F(RobotSimTest, LyingManagerChangesNothing) {
  const auto robot = StartRobot({"--manager", "lie", "--transition-ms", "1"});
  Observer observer(domain_);
  const Listener camera(observer.participant(), "/camera/image_raw", "sensor_msgs/msg/Image");

  EXPECT_TRUE(observer.ChangeMode("/safety", "ALERT"));

  const size_t before = camera.count();
  EXPECT_TRUE(Eventually([&] { return camera.count() > before + 10; }));
  EXPECT_EQ(observer.Mode("/safety"), "__DEFAULT__");
  EXPECT_EQ(observer.State("/camera"), 3);
}

TEST_F(RobotSimTest, RefusingAndDeceivingManagers) {
  {
    const auto robot = StartRobot({"--manager", "refuse"});
    Observer observer(domain_);
    EXPECT_FALSE(observer.ChangeMode("/safety", "ALERT"));
    EXPECT_EQ(observer.Mode("/safety"), "__DEFAULT__");
    EXPECT_EQ(robot->Finish(true), 0);
  }
  const auto robot = StartRobot({"--manager", "deceive", "--manager-node", "/__mode_manager"});
  Observer observer(domain_);
  EXPECT_TRUE(observer.ChangeMode("/safety", "ALERT"));
  EXPECT_EQ(observer.Mode("/safety"), "ALERT");
  EXPECT_EQ(observer.State("/camera"), 3);
  EXPECT_TRUE(Eventually([&] { return observer.Nodes().size() >= 5; }));
  EXPECT_THAT(observer.Nodes(), Contains("/__mode_manager"));
}

TEST_F(RobotSimTest, SlowManagerAnswersAfterTheModeIsReached) {
  const auto robot = StartRobot({"--answer-ms", "700", "--transition-ms", "20"});
  Observer observer(domain_);
  EXPECT_EQ(observer.Mode("/safety"), "__DEFAULT__");
  const absl::Time start = absl::Now();
  EXPECT_TRUE(observer.ChangeMode("/safety", "HALT"));
  EXPECT_GE(absl::Now() - start, absl::Milliseconds(700));
  EXPECT_EQ(observer.Mode("/safety"), "HALT");
}

TEST_F(RobotSimTest, WithoutManagerThePartsStillAnswer) {
  const auto robot = StartRobot({"--manager", "absent"});
  Observer observer(domain_);
  EXPECT_EQ(observer.State("/camera"), 3);
  EXPECT_FALSE(observer.Find("rq/safety/change_modeRequest", false).has_value());
}

TEST_F(RobotSimTest, ShortGidsAndBadNeighbours) {
  const auto robot = StartRobot({"--gid-size", "16", "--bad-discovery"});
  Observer observer(domain_);

  EXPECT_TRUE(Eventually([&] { return observer.Nodes().size() == 5; }));
  for (const ros2::ParticipantEntities& info : observer.Infos()) {
    EXPECT_EQ(info.gid_bytes, ros2::GidBytes::k16);
  }
  EXPECT_EQ(robot->Await("bad_discovery").value("sent", 0), 9);
  EXPECT_TRUE(Eventually([&] { return observer.refused() > 0; }));
  EXPECT_EQ(observer.Nodes().size(), 5U);
}

TEST_F(RobotSimTest, IntrudersComeAndSayGoodbye) {
  Observer observer(domain_);
  const Listener command(observer.participant(), "/cmd_vel", "geometry_msgs/msg/Twist");

  const auto rogue = Start({"intruder", "--mode", "rogue-cmd-vel", "--node", "/evil/driver"});
  EXPECT_GT(rogue->Await("first_sample").value("unix_ns", int64_t{0}), 0);
  EXPECT_TRUE(Eventually([&] { return command.count() > 0; }));
  EXPECT_DOUBLE_EQ(DecodeTwist(command.last())->angular_z, 1.5);
  EXPECT_NEAR(command.Rate(absl::Seconds(1)), 20, 3 * kSlack);
  EXPECT_TRUE(Eventually([&] { return observer.Nodes().size() == 1; }));
  EXPECT_THAT(observer.Nodes(), ElementsAre("/evil/driver"));
  EXPECT_EQ(rogue->Finish(true), 0);
  EXPECT_TRUE(Eventually([&] { return observer.Endpoints().empty(); }));

  const auto watcher = Start({"intruder", "--mode", "unknown-node", "--anonymous"});
  EXPECT_TRUE(Eventually([&] { return observer.Find("rt/camera/image_raw", false); }));
  EXPECT_EQ(observer.Endpoints().size(), 1U);
  EXPECT_FALSE(observer.Find("rt/camera/image_raw", false)->qos.reliable);
  EXPECT_EQ(watcher->Finish(true), 0);
}

TEST_F(RobotSimTest, CommandsReadAndOrderModes) {
  const auto robot = StartRobot();

  const auto set = Start({"set-mode", "--mode", "ALERT", "--wait-ms", "10000"});
  EXPECT_EQ(set->Await("set_mode").value("success", false), true);
  EXPECT_EQ(set->Await("reached").value("mode", ""), "ALERT");
  EXPECT_EQ(set->Finish(false), 0);

  const auto get = Start({"mode", "--smh", kSmh});
  const nlohmann::json mode = get->Await("mode_of");
  EXPECT_EQ(mode.value("mode", ""), "ALERT");
  EXPECT_EQ(mode.value("state", ""), "active");
  EXPECT_EQ(mode["available"].dump(), R"(["ALERT","COMPROMISED","HALT","__DEFAULT__"])");
  ASSERT_EQ(mode["parts"].size(), 4U);
  EXPECT_EQ(mode["parts"][1].value("part", ""), "/camera");
  EXPECT_EQ(mode["parts"][1].value("state", ""), "inactive");
  EXPECT_EQ(mode["parts"][0]["parameters"].value("max_speed", ""), "0.2");
  EXPECT_EQ(get->Finish(false), 0);

  const auto refused = Start({"set-mode", "--mode", "NO_SUCH_MODE"});
  EXPECT_EQ(refused->Await("set_mode").value("success", true), false);
  EXPECT_EQ(refused->Finish(false), 1);
}

TEST_F(RobotSimTest, ProbeMeasuresAndIsNoNode) {
  const auto robot = StartRobot();
  Observer observer(domain_);
  EXPECT_TRUE(Eventually([&] { return observer.Nodes().size() == 5; }));
  const size_t before = observer.Infos().size();

  const auto probe = Start({"probe", "--window-ms", "1500", "--count", "2"});
  probe->Await("rate");
  const nlohmann::json rate = probe->Await("rate");

  EXPECT_NEAR(rate.value("hz", 0.0), 15, 2 * kSlack);
  EXPECT_GT(rate.value("last_sample_unix_ns", int64_t{0}), 0);
  EXPECT_EQ(observer.Infos().size(), before);
  EXPECT_EQ(probe->Finish(false), 0);
  EXPECT_EQ(robot->Finish(true), 0);
}

TEST_F(RobotSimTest, BadArgumentsAreUsageErrors) {
  EXPECT_EQ(Start({"robot"})->Finish(false), 2);
  EXPECT_EQ(Start({"robot", "--smh", kSmh, "--manager", "kind"})->Finish(false), 2);
  EXPECT_EQ(Start({"robot", "--smh", kSmh, "--gid-size", "20"})->Finish(false), 2);
  EXPECT_EQ(Start({"intruder", "--mode", "friendly"})->Finish(false), 2);
  EXPECT_EQ(Start({"robot", "--smh", "/no/such/file"})->Finish(false), 1);
}

}  // namespace
}  // namespace rips::robot_sim
