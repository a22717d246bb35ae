// A level that actuators have read back, and of which the robot shows that it is not so.
#include <string>
#include <utility>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/robot/sight/finding_samples.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::Each;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr uint8_t kCamera = 1;
constexpr uint8_t kNavigator = 2;

// ALERT has /camera inactive, COMPROMISED and HALT have /navigator, too.
class ContradictedTest : public RobotTest {
 protected:
  static ActuatorHello Hello() {
    ActuatorHello hello{.effective_level = "DEFAULT",
                        .protected_parts = {"/camera", "/navigator"},
                        .inactive_parts = {{"DEFAULT", {}},
                                           {"ALERT", {"/camera"}},
                                           {"COMPROMISED", {"/camera", "/navigator"}},
                                           {"HALT", {"/camera", "/navigator"}}}};
    hello.published_while_inactive = {"/camera/health"};
    return hello;
  }
  void StartAt(const std::string& level, const ActuatorHello& hello = Hello()) {
    Start();
    ConnectSensor();
    ConnectActuator(hello);
    SendSnapshot();
    ros2::GraphDelta delta;
    AddNode(&delta, kCamera, "/camera", "/camera/image");
    SendDelta(std::move(delta));
    Obey();
    Pass(1'000);
    if (level != Level()) Raise(level);
  }
  void Raise(const std::string& level) {
    robot_->Raise({.operator_name = "alice", .to = level, .reason = "drill"},
                  [](const LevelAnswer&) {});
    Drain();
    Obey();
    Pass(50);
  }
  // Ten messages a second.
  void GoOn(int64_t ms, uint8_t writer = kNavigator, const char* topic = "/cmd_vel") {
    for (int64_t passed = 0; passed < ms; passed += 100) {
      SendMessage(writer, topic);
      Pass(100);
    }
  }
  // A message that was taken `ago_ms` ago.
  void SendOld(int64_t ago_ms, uint8_t writer = kNavigator) {
    SendBatch(Lane::kMessages, {{.boottime_ns = Boottime() - ago_ms * kNanosPerMilli,
                                 .what = MessageSeen{.topic = "/cmd_vel",
                                                     .type = "geometry_msgs/msg/Twist",
                                                     .writer = Writer(writer),
                                                     .size_bytes = 52}}});
  }
  int Contradictions() { return audience_.Count("was verified, and is contradicted"); }
};

TEST_F(ContradictedTest, APartThatGoesOnContradictsTheLevel) {
  StartAt("COMPROMISED");
  ASSERT_EQ(Stage(), "verified");
  GoOn(900);
  EXPECT_EQ(Stage(), "verified") << "what was under way";
  GoOn(600);
  EXPECT_EQ(Stage(), "contradicted");
  EXPECT_EQ(Level(), "COMPROMISED") << "the decision stands";
  EXPECT_EQ(recorder_.stages.back().stage, "contradicted");
  EXPECT_THAT(recorder_.stages.back().detail,
              HasSubstr("node /navigator publishes /cmd_vel (writer 01100200.00000000.00000000."));
  EXPECT_EQ(Contradictions(), 1);
  EXPECT_THAT(audience_.alerts,
              Contains(AllOf(
                  Field(&store::AlertRecord::severity, "critical"),
                  Field(&store::AlertRecord::text, HasSubstr("and COMPROMISED has it inactive")))));
  EXPECT_THAT(robot_->Status().degraded,
              Contains(HasSubstr("level COMPROMISED is contradicted: node /navigator")));
  GoOn(5'000);
  EXPECT_EQ(Contradictions(), 1);
}

TEST_F(ContradictedTest, AFloorDoesNotLiftMeanwhile) {
  StartAt("COMPROMISED");
  EXPECT_TRUE(actuator_->leases.back().evidence_complete);
  GoOn(2'000);
  EXPECT_FALSE(actuator_->leases.back().evidence_complete);
}

TEST_F(ContradictedTest, WhatWasTakenBeforeIsJudgedLateAndIsNoContradiction) {
  StartAt("COMPROMISED");
  Pass(4'000);
  for (int64_t ago_ms = 5'000; ago_ms > 3'100; ago_ms -= 100) SendOld(ago_ms);
  Pass(100);
  EXPECT_EQ(Stage(), "verified");
  SendOld(2'000);
  SendOld(1'600);
  Pass(50);
  EXPECT_EQ(Stage(), "contradicted") << "what was taken since is not";
}

TEST_F(ContradictedTest, OneMessageOfAWriterIsNone) {
  StartAt("COMPROMISED");
  Pass(2'000);
  SendMessage(kNavigator);
  SendMessage(kCamera, "/camera/image");
  for (int i = 0; i < 5; ++i) SendMessage(kNavigator);
  Pass(100);
  EXPECT_EQ(Stage(), "verified") << "a latched history comes again at once";
  Pass(11'000);
  SendMessage(kNavigator);
  Pass(50);
  EXPECT_EQ(Stage(), "verified") << "and comes again with the next reader";
}

TEST_F(ContradictedTest, ASensorThatStartsAnewHearsHistoryAgain) {
  StartAt("COMPROMISED");
  Pass(2'000);
  SendMessage(kNavigator);
  robot_->OnSensorGone("base", sensor_.get());
  ConnectSensor();
  Pass(500);
  SendMessage(kNavigator);
  Pass(1'000);
  EXPECT_EQ(Stage(), "verified");
  GoOn(1'000);
  EXPECT_EQ(Stage(), "contradicted");
}

TEST_F(ContradictedTest, TopicsThatInactiveNodesPublishHonestlyAreSpared) {
  StartAt("COMPROMISED");
  Pass(1'500);
  for (const char* topic : {"/rosout", "/parameter_events", "/navigator/transition_event",
                            "/diagnostics", "/drive/_action/status", "/camera/health"}) {
    GoOn(1'000, kNavigator, topic);
    EXPECT_EQ(Stage(), "verified") << topic;
  }
  GoOn(1'000, kCamera, "/camera/image");
  EXPECT_EQ(Stage(), "contradicted");
}

TEST_F(ContradictedTest, OnlyWhatTheLevelHasInactiveMustBeSilent) {
  StartAt("ALERT");
  GoOn(3'000, kNavigator);
  EXPECT_EQ(Stage(), "verified");
  Raise("COMPROMISED");
  GoOn(2'000, kNavigator);
  EXPECT_EQ(Stage(), "contradicted");
}

TEST_F(ContradictedTest, AnActuatorAboveTheLevelMustBeSilentInBoth) {
  ActuatorHello hello = Hello();
  hello.inactive_parts[3].parts = {"/navigator"};  // HALT has /camera active
  StartAt("COMPROMISED", hello);
  effective_ = "HALT";
  floor_ = "lease lost";
  Pass(100);
  GoOn(3'000, kCamera, "/camera/image");
  EXPECT_EQ(Stage(), "verified");
  effective_ = "COMPROMISED";
  floor_ = "";
  GoOn(900, kCamera, "/camera/image");
  EXPECT_EQ(Stage(), "verified") << "it was read back just now";
  GoOn(900, kCamera, "/camera/image");
  EXPECT_EQ(Stage(), "contradicted");
}

TEST_F(ContradictedTest, ASensorWhoseHelloTookLongMakesNoOldMessageNew) {
  Start();
  sensor_ = std::make_shared<FakeSensor>();
  Instant sent = clock_.Now();
  sent.boottime_ns -= 4 * kNanosPerSecond;
  robot_->OnSensorHello("base", sensor_, {.incarnation = kIncarnation, .clock = sent});
  AnswerInterest();
  Drain();
  ConnectActuator(Hello());
  SendSnapshot();
  Obey();
  Pass(1'000);
  Raise("COMPROMISED");
  SendOld(500);
  SendOld(100);
  Pass(100);
  EXPECT_EQ(Stage(), "verified");
  GoOn(2'000);
  EXPECT_EQ(Stage(), "contradicted");
}

TEST_F(ContradictedTest, EndsWhenNothingIsHeardForLongAndTheRobotIsSeen) {
  StartAt("COMPROMISED");
  GoOn(2'000);
  ASSERT_EQ(Stage(), "contradicted");
  Pass(9'000);
  robot_->OnSensorGone("base", sensor_.get());
  sensor_heartbeats_ = false;
  Pass(5'000);
  EXPECT_EQ(Stage(), "contradicted") << "silence that is not seen is none";
  sensor_heartbeats_ = true;
  ConnectSensor();
  SendSnapshot();
  Pass(9'000);
  EXPECT_EQ(Stage(), "contradicted");
  Pass(1'500);
  EXPECT_EQ(Stage(), "verified");
  EXPECT_EQ(recorder_.stages.back().stage, "verified");
  EXPECT_EQ(audience_.Count("is verified again"), 1);
  GoOn(1'000);
  EXPECT_EQ(Stage(), "contradicted") << "and begins again";
  EXPECT_EQ(Contradictions(), 2);
}

TEST_F(ContradictedTest, EndsWithTheNextReadingBack) {
  StartAt("COMPROMISED");
  GoOn(2'000);
  ASSERT_EQ(Stage(), "contradicted");
  verified_ = false;  // the actuator finds the level left
  Pass(100);
  EXPECT_EQ(Stage(), "acknowledged");
  verified_ = true;
  Pass(100);
  EXPECT_EQ(Stage(), "verified");
  GoOn(2'000);
  ASSERT_EQ(Stage(), "contradicted");
  Raise("HALT");
  EXPECT_EQ(Stage(), "verified") << "of another decision";
}

TEST_F(ContradictedTest, NoRuleLowersMeanwhile) {
  StartAt("DEFAULT");
  IntruderAppears();
  ASSERT_EQ(Level(), "ALERT");
  Obey();
  Pass(1'000);
  for (int i = 0; i < 3; ++i) GoOn(500, kCamera, "/camera/image");
  ASSERT_EQ(Stage(), "contradicted");
  IntruderLeaves();
  GoOn(8'000, kCamera, "/camera/image");
  EXPECT_EQ(Level(), "ALERT") << "the hold of 5 s has passed";
  Pass(9'000);
  EXPECT_EQ(Level(), "ALERT");
  Pass(8'000);
  EXPECT_EQ(Level(), "DEFAULT") << "silent for 10 s, and the hold";
}

TEST_F(ContradictedTest, AnActuatorThatDoesNotSayIsReportedOnceAndNeverContradicted) {
  ActuatorHello old = Hello();
  old.inactive_parts.clear();
  StartAt("COMPROMISED", old);
  GoOn(3'000);
  EXPECT_EQ(Stage(), "verified");
  EXPECT_EQ(audience_.Count("does not say which nodes its levels have inactive"), 1);
}

TEST_F(ContradictedTest, ManyWritersOfOneNodeAreOne) {
  StartAt("COMPROMISED");
  Pass(1'500);
  for (int i = 0; i < 600 && Stage() == "verified"; ++i) {
    MessageSeen message{.topic = "/cmd_vel",
                        .type = "geometry_msgs/msg/Twist",
                        .writer = Writer(kNavigator),
                        .size_bytes = 52};
    message.writer.bytes[12] = static_cast<uint8_t>(i / 250);
    message.writer.bytes[13] = static_cast<uint8_t>(i);
    ros2::GraphDelta delta;
    delta.upsert_endpoints.push_back({.guid = message.writer,
                                      .kind = ros2::EndpointKind::kPublisher,
                                      .name = "/cmd_vel",
                                      .type = "geometry_msgs/msg/Twist",
                                      .node = "/navigator"});
    SendDelta(std::move(delta));
    SendBatch(Lane::kMessages, {{.what = std::move(message)}});
    Pass(50);
  }
  EXPECT_EQ(Stage(), "contradicted");
}

// -------------------------------------------------------------------------------- forgeries

class ForgeryTest : public ContradictedTest {
 protected:
  FindingSeen Of(const std::string& kind, const ros2::Guid& guid) {
    return {.kind = kind, .guid = guid, .detail = "why"};
  }
  void Tell(FindingSeen finding) {
    SendBatch(Lane::kControl, {{.what = std::move(finding)}});
    Pass(50);
  }
};

TEST_F(ForgeryTest, OfAPartMakesTheLevelUnverifiedWhileItStands) {
  StartAt("ALERT");
  for (const char* kind : {"spoofed_writer", "sequence_jump", "two_contents", "rival_server"}) {
    const FindingSeen finding = Of(kind, Writer(kNavigator));
    Tell(finding);
    EXPECT_EQ(Stage(), "contradicted") << kind;
    EXPECT_THAT(robot_->Status().degraded,
                Contains(HasSubstr("what is read back from the robot may")));
    Tell(Over(finding));
    EXPECT_EQ(Stage(), "verified") << kind;
  }
  EXPECT_EQ(Contradictions(), 4);
}

TEST_F(ForgeryTest, OfTheActuatorItselfToo) {
  ActuatorHello hello = Hello();
  hello.participant = Participant(7);
  StartAt("ALERT", hello);
  Tell(Of("spoofed_writer", Participant(7)));
  EXPECT_EQ(Stage(), "contradicted");
}

TEST_F(ForgeryTest, OfOthersDoesNot) {
  StartAt("ALERT");
  Tell(Of("spoofed_writer", Writer(8)));
  Tell(Of("duplicate_node", Writer(kNavigator)));
  Tell(Of("spoofed_writer", {}));
  EXPECT_EQ(Stage(), "verified");
}

TEST_F(ForgeryTest, AnActionThatWaitsForTheLevelDoesNotHappen) {
  Start(R"(
levels: DEFAULT; ALERT; COMPROMISED; HALT;
rules External:
  asked: signal("SIGUSR1") ? trigger(COMPROMISED) => alert("the robot stands", "info");
  unused: false ? trigger(HALT);
  alert: false ? trigger(ALERT);
)");
  ConnectSensor();
  ConnectActuator(Hello());
  SendSnapshot();
  Obey();
  Pass(100);
  Tell(Of("spoofed_writer", Writer(kNavigator)));
  SendBatch(Lane::kControl, {{.what = SignalSeen{.name = "SIGUSR1"}}});
  ASSERT_EQ(Level(), "COMPROMISED");
  Obey();
  Pass(500);
  EXPECT_EQ(Stage(), "contradicted");
  EXPECT_EQ(audience_.Count("the robot stands"), 0);
}

}  // namespace
}  // namespace rips::pipeline
