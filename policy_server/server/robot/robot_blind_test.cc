// A sensor that sees nothing proves nothing.
#include <algorithm>
#include <iterator>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/model/dds_problem.h"

namespace rips::pipeline {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr char kNobody[] =
    "sensor base sees no ROS node on domain 7; are dds.domain and dds.interface right?";

class RobotBlindTest : public RobotTest {
 protected:
  void Hello(std::vector<std::string> blind = {}, const std::string& incarnation = kIncarnation) {
    if (sensor_) robot_->OnSensorGone("base", sensor_.get());
    sensor_ = std::make_shared<FakeSensor>();
    if (std::exchange(incarnation_, incarnation) != incarnation) {
      std::fill(std::begin(next_sequence_), std::end(next_sequence_), 1);
    }
    robot_->OnSensorHello("base", sensor_,
                          {.incarnation = incarnation,
                           .clock = clock_.Now(),
                           .domain = 7,
                           .blind = std::move(blind)});
    AnswerInterest();
    Drain();
  }
  // A settled graph that shows what `content` does and the sensor itself.
  void Snapshot(ros2::GraphDelta content = {}) {
    AddNode(&content, 100, "/rips");
    graph_version_ = 1;
    SendBatch(Lane::kControl,
              {{.what = GraphChange{.to_version = 1, .settled = true, .delta = content}}});
  }
  void SendState(SensorStateSeen state, int64_t boottime_ns = 0) {
    SendBatch(Lane::kControl, {{.boottime_ns = boottime_ns, .what = std::move(state)}});
  }
  void ArmWith(ros2::GraphDelta content, std::vector<std::string> parts = {}) {
    Start();
    Hello();
    ConnectActuator({.effective_level = "DEFAULT", .protected_parts = std::move(parts)});
    Snapshot(std::move(content));
    Obey();
    Pass(100);
  }
  std::vector<std::string> Degraded() const { return robot_->Status().degraded; }
  // Rules have raised the robot to ALERT, and nothing but the evidence keeps them from lowering it.
  void RaiseAndCalm() {
    IntruderAppears();
    ASSERT_EQ(Level(), "ALERT");
    Obey();
    IntruderLeaves();
  }
  bool Refused(const std::string& part) const {
    for (const store::RefusalRecord& refusal : recorder_.refusals) {
      if (absl::StrContains(refusal.reason, part)) return true;
    }
    return false;
  }
};

TEST_F(RobotBlindTest, ASensorThatSeesNobodyIsDegraded) {
  std::optional<size_t> counted;
  counts_.blind = [&](const std::string&, size_t reasons) { counted = reasons; };
  ArmWith({});
  EXPECT_THAT(Degraded(), ElementsAre(kNobody));
  EXPECT_THAT(robot_->core().sight().blind(), ElementsAre(kNobody));
  EXPECT_EQ(counted, 1u);
  SendDelta(NormalGraph());
  EXPECT_THAT(Degraded(), IsEmpty());
  EXPECT_THAT(robot_->core().sight().blind(), IsEmpty());
  EXPECT_EQ(counted, 0u);
}

TEST_F(RobotBlindTest, ASensorThatSeesNobodyLowersNothing) {
  ArmWith(NormalGraph());
  RaiseAndCalm();
  ros2::GraphDelta gone;
  gone.gone_guids = {Participant(1), Participant(2)};
  SendDelta(gone);
  Pass(20'000);
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_TRUE(Refused("sees no ROS node on domain 7"));

  ros2::GraphDelta back = NormalGraph();
  SendDelta(back);
  Pass(10'000);
  EXPECT_EQ(Level(), "DEFAULT") << "it lowers when the robot is seen again";
}

// `nodesinclude` is true of a graph in which nobody is left.
TEST_F(RobotBlindTest, TheVeryGraphThatShowsNobodyLowersNothing) {
  Start(R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules Graph:
  all_known: CurrLevel == ALERT && nodesinclude("/camera", "/navigator", "/rips") ?
    trigger(DEFAULT);
rules External:
  up: signal("USR1") ? trigger(ALERT);
  never: false ? trigger(COMPROMISED), trigger(HALT);
)");
  Hello();
  ConnectActuator({.effective_level = "DEFAULT"});
  Snapshot(NormalGraph());
  Obey();
  SendBatch(Lane::kControl, {{.what = SignalSeen{.name = "USR1"}}});
  ASSERT_EQ(Level(), "ALERT");
  Obey();
  Pass(20'000);
  ros2::GraphDelta gone;
  gone.gone_guids = {Participant(1), Participant(2)};
  SendDelta(gone);
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_TRUE(Refused("sees no ROS node"));
}

TEST_F(RobotBlindTest, AnOperatorIsToldThatNobodyIsSeen) {
  ArmWith(NormalGraph());
  IntruderAppears();
  Obey();
  ros2::GraphDelta gone;
  gone.gone_guids = {Participant(1), Participant(2), Participant(9)};
  SendDelta(gone);
  LevelAnswer answer;
  LevelOrder order{.operator_name = "alice",
                   .to = "DEFAULT",
                   .reason = "r",
                   .expected_level = "ALERT",
                   .expected_decision_id = robot_->Status().decision_id,
                   .request_id = "1"};
  robot_->DeEscalate(order, [&](const LevelAnswer& got) { answer = got; });
  Drain();
  EXPECT_EQ(answer.status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(answer.blind_because, Contains(kNobody));
  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(RobotBlindTest, LessThanWhatTheActuatorSteersIsBlind) {
  ArmWith(NormalGraph(), {"/camera", "/safety"});
  EXPECT_THAT(Degraded(), ElementsAre("sensor base does not see /safety on domain 7, whose modes "
                                      "the actuator sets"));
  ros2::GraphDelta delta;
  AddNode(&delta, 3, "/mode_manager");
  delta.upsert_endpoints.push_back({.guid = Writer(3),
                                    .kind = ros2::EndpointKind::kService,
                                    .name = "/safety/change_mode",
                                    .type = "system_modes_msgs/srv/ChangeMode",
                                    .node = "/mode_manager"});
  SendDelta(delta);
  EXPECT_THAT(Degraded(), IsEmpty());
}

TEST_F(RobotBlindTest, AFloorStaysWhileNobodyIsSeen) {
  ArmWith({});
  Pass(600);
  EXPECT_FALSE(actuator_->leases.back().evidence_complete);
  SendDelta(NormalGraph());
  Pass(600);
  EXPECT_TRUE(actuator_->leases.back().evidence_complete);
  SendState({.blind = {"ids log /l: gone"}});
  Pass(600);
  EXPECT_FALSE(actuator_->leases.back().evidence_complete);
}

TEST_F(RobotBlindTest, IsToldOnceAfterAMinuteAndWhenItIsOver) {
  ArmWith({});
  audience_.alerts.clear();
  Pass(55'000);
  EXPECT_THAT(audience_.alerts, IsEmpty()) << "the ROS stack may just be starting";
  Pass(700'000);
  ASSERT_EQ(audience_.alerts.size(), 1u);
  EXPECT_THAT(audience_.alerts[0].text, HasSubstr("blind: sensor base sees no ROS node"));
  EXPECT_EQ(audience_.alerts[0].rule, "(rips)");
  EXPECT_EQ(audience_.alerts[0].severity, "medium") << "the ROS stack may be off";
  SendDelta(NormalGraph());
  Pass(1'000);
  ASSERT_EQ(audience_.Count("r1 is seen again"), 1);
  Pass(100'000);
  EXPECT_EQ(audience_.Count("seen"), 1);
}

TEST_F(RobotBlindTest, ABlindSensorThatIsStoppedDoesNotSeeAgain) {
  ArmWith({});
  Pass(100'000);
  ASSERT_EQ(audience_.Count("blind: sensor base sees no ROS node"), 1);
  robot_->OnSensorGone("base", sensor_.get());
  Pass(10'000);
  Hello();
  Pass(1'000);
  EXPECT_EQ(audience_.Count("is seen again"), 0);

  Snapshot(NormalGraph());
  Pass(1'000);
  EXPECT_EQ(audience_.Count("r1 is seen again"), 1);
}

TEST_F(RobotBlindTest, IsWorseIfTheActuatorReadsTheModesOfItsParts) {
  ArmWith({}, {"/safety"});
  Pass(70'000);
  EXPECT_EQ(audience_.Count("blind: sensor base sees no ROS node"), 1);
  EXPECT_EQ(audience_.alerts.back().severity, "high") << "the robot runs, and is not seen";
}

// ------------------------------------------------------------------- what a sensor says of itself

TEST_F(RobotBlindTest, AnInputThatASensorCannotReadIsBlind) {
  ArmWith(NormalGraph());
  RaiseAndCalm();
  SendState({.blind = {"ids log /var/log/eve.json: permission denied\x1b[2J"}});
  const std::string text = "sensor base: ids log /var/log/eve.json: permission denied\\x1b[2J";
  EXPECT_THAT(Degraded(), Contains(text));
  Pass(70'000);
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(audience_.Count("blind: " + text), 1);
  EXPECT_EQ(audience_.alerts.back().severity, "high");
  SendState({});
  EXPECT_THAT(Degraded(), Not(Contains(text)));
  Pass(10'000);
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(RobotBlindTest, KindsOfTrafficThatNobodyAskedForDoNotBlind) {
  ArmWith(NormalGraph());
  SendState({.not_visible = {"unicast-only writers"}});
  EXPECT_THAT(Degraded(), IsEmpty());
  EXPECT_THAT(robot_->core().sight().blind(), IsEmpty());
}

TEST_F(RobotBlindTest, AHelloMaySayItToo) {
  ArmWith(NormalGraph());
  Hello({"wire tap: none"});
  EXPECT_THAT(Degraded(), Contains("sensor base: wire tap: none"));
  Hello();
  EXPECT_THAT(robot_->core().sight().blind(), IsEmpty());
}

// A sensor follows its host to another address: a process as new as after a restart.
TEST_F(RobotBlindTest, ASensorOnAnotherAddressIsToldAtOnceAndLowersNothingMeanwhile) {
  ArmWith(NormalGraph());
  RaiseAndCalm();
  const std::string why =
      absl::StrCat(model::kDdsBeginsAgain, "eth0 had 10.0.0.2 and has 10.0.0.3");
  Hello({why}, std::string(16, 'm'));
  EXPECT_THAT(Degraded(), Contains("sensor base: " + why));
  Snapshot(NormalGraph());
  Pass(20'000);
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(audience_.Count("blind: sensor base: " + why), 1);
  EXPECT_EQ(audience_.Count("r1 is seen again"), 0);
  SendState({});
  Pass(10'000);
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(audience_.Count("r1 is seen again"), 1);
}

TEST_F(RobotBlindTest, TheRobotIsNotBlamedOnTheConfigurationWhenTheAddressHasChanged) {
  ArmWith(NormalGraph());
  const std::string why = absl::StrCat(model::kDdsBeginsAgain, "eth0 lost 10.0.0.2");
  Hello({why}, std::string(16, 'm'));
  Snapshot();
  EXPECT_THAT(Degraded(), Contains(HasSubstr("sees no ROS node on domain 7 since its host's "
                                             "addresses changed")));
  EXPECT_THAT(Degraded(), Not(Contains(kNobody)));
  SendState({});
  EXPECT_THAT(Degraded(), Contains(kNobody));
}

TEST_F(RobotBlindTest, ASensorThatFollowsItsAddressesHasNotRestarted) {
  ArmWith(NormalGraph());
  for (char process = 'a'; process < 'i'; ++process) {
    Hello({absl::StrCat(model::kDdsBeginsAgain, "eth0 had ", std::string(1, process))},
          std::string(16, process));
    Pass(1'000);
  }
  EXPECT_EQ(audience_.Count("has restarted"), 0);
  for (char process = 'p'; process < 's'; ++process) Hello({}, std::string(16, process));
  Pass(1'000);
  EXPECT_EQ(audience_.Count("has restarted"), 1);
}

TEST_F(RobotBlindTest, WhatWasSaidBeforeTheHelloDoesNotReplaceIt) {
  ArmWith(NormalGraph());
  const int64_t before_ns = Boottime();
  Pass(1'000);
  Hello({"ids log /l: gone"});
  // From the backlog; it was all right then.
  SendState({.blind = {}}, before_ns);
  EXPECT_THAT(robot_->core().sight().blind(), ElementsAre("sensor base: ids log /l: gone"));
  SendState({.blind = {}});
  EXPECT_THAT(robot_->core().sight().blind(), IsEmpty());
}

TEST_F(RobotBlindTest, AHostileSensorDoesNotFillTheStatus) {
  ArmWith(NormalGraph());
  SendState({.blind = std::vector<std::string>(32, std::string(1'000, 'x'))});
  const std::vector<std::string> degraded = Degraded();
  EXPECT_EQ(degraded.size(), 17u);
  for (const std::string& text : degraded) EXPECT_LT(text.size(), 600u);
  EXPECT_EQ(degraded.back(), "sensor base: 16 more inputs");
}

TEST_F(RobotBlindTest, ASensorThatIsGoneSaysNothing) {
  ArmWith({});
  robot_->OnSensorGone("base", sensor_.get());
  sensor_.reset();
  Pass(100);
  EXPECT_THAT(robot_->core().sight().blind(), IsEmpty());
  EXPECT_THAT(Degraded(), ElementsAre("sensor base is not connected"));
}

// -------------------------------------------------------------------------- a graph at its limits

TEST_F(RobotBlindTest, ATruncatedGraphIsIncompleteEvidenceAndACriticalAlert) {
  ArmWith(NormalGraph());
  audience_.alerts.clear();
  ros2::GraphDelta flood;
  flood.upsert_participants.push_back({.guid = Participant(50)});
  flood.upsert_nodes.push_back({.full_name = "/flood", .participant = Participant(50)});
  for (int i = 0; i < 5'000; ++i) {
    ros2::Guid guid = Participant(50);
    guid.bytes[13] = static_cast<uint8_t>(i >> 8);
    guid.bytes[14] = static_cast<uint8_t>(i);
    guid.bytes[15] = 3;
    flood.upsert_endpoints.push_back(
        {.guid = guid, .name = absl::StrCat("/t", i), .type = "a/msg/B", .node = "/flood"});
  }
  SendDelta(flood);
  Pass(1'000);
  EXPECT_EQ(audience_.Count("the graph of sensor base hit a limit (up to 2952 left out)"), 1);
  EXPECT_EQ(audience_.Count("(node /flood) has 1 of 4 nodes and 2048 of 2049 endpoints, 2952 more "
                            "left out"),
            1);
  EXPECT_EQ(audience_.Count("holds 2048 endpoints of the graph"), 1);
  for (const store::AlertRecord& alert : audience_.alerts) {
    if (absl::StrContains(alert.text, "hit a limit")) {
      EXPECT_EQ(alert.severity, "critical");
    }
  }
  EXPECT_THAT(robot_->core().sight().blind(), ElementsAre(HasSubstr("hit a limit")));
  EXPECT_THAT(Degraded(), Contains(HasSubstr("hit a limit")));
  EXPECT_FALSE(actuator_->leases.back().evidence_complete);
  Pass(300'000);
  EXPECT_EQ(audience_.Count("hit a limit"), 1);
  EXPECT_TRUE(sensor_->closed.ok());

  // What was left out is not known, even when the flood is over: the sensor tells the graph anew.
  ros2::GraphDelta over;
  over.gone_guids = {Participant(50)};
  SendDelta(over);
  EXPECT_THAT(robot_->core().sight().blind(), ElementsAre(HasSubstr("hit a limit")));
  Pass(200);
  EXPECT_EQ(sensor_->closed.code(), absl::StatusCode::kAborted);
  sensor_.reset();
  Hello();
  EXPECT_TRUE(sensor_->setup.want_snapshot);
  Snapshot(NormalGraph());
  EXPECT_THAT(robot_->core().sight().blind(), IsEmpty());
  Pass(120'000);
  EXPECT_TRUE(sensor_->closed.ok());
  EXPECT_EQ(audience_.Count("the graph of sensor base is whole again"), 1);
  EXPECT_EQ(audience_.Count("hit a limit ("), 1);
}

// ------------------------------------------------------------- a graph that the sensor cut short

TEST_F(RobotBlindTest, WhatTheSensorLeavesOutIsLeftOut) {
  std::vector<std::pair<uint64_t, bool>> counted;
  counts_.graph_left_out = [&](const std::string&, uint64_t left_out, bool began) {
    counted.emplace_back(left_out, began);
  };
  ArmWith(NormalGraph());
  audience_.alerts.clear();
  SendDelta({.truncation = ros2::Truncation{.left_out = 64, .crowds = {{Participant(2), 9, 64}}}});
  EXPECT_THAT(robot_->core().sight().blind(), ElementsAre(HasSubstr("graph truncated")));
  EXPECT_THAT(Degraded(), Contains(HasSubstr("graph truncated")));
  Pass(2'000);
  EXPECT_FALSE(actuator_->leases.back().evidence_complete);
  EXPECT_EQ(
      audience_.Count("graph truncated: the graph of sensor base hit a limit (up to 64 left out); "
                      "participant "),
      1);
  EXPECT_EQ(audience_.Count("(node /navigator) has 1 of"), 1);
  // The first counts stand in the alert, and another participant has one of its own.
  SendDelta({.truncation = ros2::Truncation{
                 .left_out = 128, .crowds = {{Participant(2), 9, 64}, {Participant(1), 3, 32}}}});
  Pass(2'000);
  EXPECT_EQ(audience_.Count("hit a limit ("), 1);
  EXPECT_EQ(audience_.Count("(node /camera) holds 3 endpoints of the graph; 32 more"), 1);
  EXPECT_EQ(audience_.Count("(node /navigator) holds 9 endpoints of the graph; 64 more"), 1);

  // A sensor that goes away does not end it.
  robot_->OnSensorGone("base", sensor_.get());
  sensor_.reset();
  Pass(1'000);
  EXPECT_EQ(audience_.Count("is whole again"), 0);
  Hello();
  SendDelta({.truncation = ros2::Truncation{}});
  Pass(1'000);
  EXPECT_TRUE(sensor_->closed.ok()) << "the sensor asked discovery itself";
  EXPECT_EQ(audience_.Count("the graph of sensor base is whole again"), 1);
  EXPECT_THAT(robot_->core().sight().blind(), IsEmpty());
  EXPECT_THAT(counted, ElementsAre(std::pair(0u, false), std::pair(64u, true),
                                   std::pair(128u, false), std::pair(0u, false)));
  // It comes back: told again.
  SendDelta({.truncation = ros2::Truncation{.left_out = 1}});
  Pass(1'000);
  EXPECT_EQ(audience_.Count("hit a limit ("), 2);
}

TEST_F(RobotBlindTest, ASoftLevelDoesNotSinkOnATruncatedGraph) {
  ArmWith(NormalGraph());
  RaiseAndCalm();
  SendDelta({.truncation = ros2::Truncation{.left_out = 1}});
  Pass(60'000);
  EXPECT_EQ(Level(), "ALERT");
  SendDelta({.truncation = ros2::Truncation{}});
  Pass(10'000);
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(RobotBlindTest, TheSensorIsToldWhichTopicsTheRulesName) {
  ArmWith(NormalGraph());
  EXPECT_EQ(sensor_->kept_topics, *robot_->core().policy().kept_topics);
}

}  // namespace
}  // namespace rips::pipeline
