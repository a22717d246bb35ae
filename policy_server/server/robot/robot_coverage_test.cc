// What is seen of a robot, what its sensors are asked for, and how they fare.
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"

namespace rips::pipeline {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr char kCoverageRules[] = R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules Msg:
  flood: topicin("/cmd_vel") && msgcount(1000, 5, 1000000) ? alert("flood");
rules External:
  restarting: agent("sensor", "restarting") ? alert("rule restarting");
  skew: agent("sensor", "clock_skew") ? alert("rule skew");
  overloaded: agent("sensor", "overloaded") ? alert("rule overloaded");
  lost: lostevents(1) ? alert("rule lost");
  false ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);
)";

class RobotCoverageTest : public RobotTest {
 protected:
  void Begin() {
    Start(kCoverageRules);
    ConnectSensor();
    SendSnapshot();
    Pass(200);
    audience_.alerts.clear();
  }
  void Lose(LossSeen loss) { SendBatch(Lane::kControl, {{.what = std::move(loss)}}); }
  void SendState(SensorStateSeen state) { SendBatch(Lane::kControl, {{.what = std::move(state)}}); }
  // A sensor process that has not been seen before.
  void Restart(const std::string& incarnation) {
    if (sensor_) robot_->OnSensorGone("base", sensor_.get());
    sensor_ = std::make_shared<FakeSensor>();
    robot_->OnSensorHello("base", sensor_, {.incarnation = incarnation, .clock = clock_.Now()});
    Drain();
  }
  void AddWriter(uint8_t n, ros2::EndpointKind kind, ros2::Visibility visibility) {
    ros2::GraphDelta delta;
    AddNode(&delta, n, absl::StrCat("/node", n), absl::StrCat("/topic", n));
    delta.upsert_endpoints[0].kind = kind;
    delta.upsert_endpoints[0].visibility = visibility;
    SendDelta(std::move(delta));
  }
  SensorCoverage Base() const { return robot_->core().sight().Coverage().at(0); }
};

TEST_F(RobotCoverageTest, ASensorIsAskedForWhatTheRulesNeed) {
  Begin();
  ASSERT_THAT(sensor_->interest, SizeIs(2));
  EXPECT_EQ(sensor_->interest[0].topic_regex, "^\\/cmd_vel$");
  EXPECT_EQ(sensor_->interest[0].depth, engine::Depth::kMetadata);
  EXPECT_THAT(sensor_->interest[0].wanted_by, ElementsAre("flood"));
  EXPECT_EQ(sensor_->interest[1].depth, engine::Depth::kNothing);
  EXPECT_EQ(*robot_->core().policy().interest, sensor_->interest);
}

TEST_F(RobotCoverageTest, UntilTheSensorWatchesWhatRulesNeedEvidenceIsIncomplete) {
  Start(kCoverageRules);
  EXPECT_FALSE(robot_->core().sight().Interests().at(0).connected);
  Restart("an incarnation.");
  SendSnapshot();
  SensorInterest one = robot_->core().sight().Interests().at(0);
  EXPECT_TRUE(one.connected);
  EXPECT_FALSE(one.in_use);
  EXPECT_EQ(one.problem, "");
  EXPECT_THAT(robot_->Status().degraded,
              testing::Contains("sensor base does not watch yet what the rules need"));

  AnswerInterest("rule 1: too large\x1b[2J");
  AnswerInterest("rule 1: too large");
  one = robot_->core().sight().Interests().at(0);
  EXPECT_FALSE(one.in_use);
  EXPECT_EQ(one.problem, "rule 1: too large\\x1b[2J");
  Drain();
  EXPECT_EQ(audience_.Count("does not watch what the rules need: rule 1"), 1) << "told once";
  EXPECT_THAT(robot_->Status().degraded, testing::Contains(HasSubstr("rule 1: too large")));

  AnswerInterest();
  one = robot_->core().sight().Interests().at(0);
  EXPECT_TRUE(one.in_use);
  EXPECT_EQ(one.problem, "");
  for (const std::string& reason : robot_->Status().degraded) {
    EXPECT_THAT(reason, testing::Not(HasSubstr("watch")));
  }
}

TEST_F(RobotCoverageTest, OtherRulesAskAnewIfTheyNeedSomethingElse) {
  Begin();
  const auto swap = [&](const std::string& id, const std::string& topic, const std::string& name) {
    const std::string text = absl::StrCat(
        "levels: DEFAULT; ALERT soft; COMPROMISED; HALT;\nrules Msg:\n  ", name, ": topicin(\"",
        topic, "\") ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);\n");
    const std::vector<lang::SourceFile> files = {{.path = "new.rul", .text = text}};
    lang::CompileResult compiled = lang::Compile(files);
    ASSERT_TRUE(compiled.rules) << lang::RenderText(files, compiled.diagnostics);
    const auto program = engine::CompiledPolicy::Create(*std::move(compiled.rules));
    ASSERT_TRUE(robot_->SwapPolicy({.program = *program, .bundle_id = id}).ok());
  };
  swap("sha256:1", "/other", "r");
  EXPECT_EQ(sensor_->interest[0].topic_regex, "^\\/other$");
  EXPECT_FALSE(robot_->core().sight().Interests().at(0).in_use);
  AnswerInterest();
  EXPECT_TRUE(robot_->core().sight().Interests().at(0).in_use);
}

TEST_F(RobotCoverageTest, RobotsShareThePlanOfTheirBundle) {
  Begin();
  const std::vector<lang::SourceFile> files = {{.path = "test.rul", .text = kCoverageRules}};
  const auto program = engine::CompiledPolicy::Create(*lang::Compile(files).rules);
  const auto plan = MakeInterest(**program);
  ASSERT_TRUE(
      robot_->SwapPolicy({.program = *program, .bundle_id = "sha256:1", .interest = plan}).ok());
  EXPECT_EQ(&*robot_->core().policy().interest, plan.get());
  EXPECT_TRUE(robot_->core().sight().Interests().at(0).in_use) << "it asks for the same";
}

TEST_F(RobotCoverageTest, AnswersToWhatIsNotWantedChangeNothing) {
  Begin();
  robot_->OnInterestAnswer("base", sensor_.get(), {.id = "older", .problem = "why"});
  robot_->OnInterestAnswer("nobody", sensor_.get(), {.id = sensor_->interest_id()});
  robot_->OnInterestAnswer("base", nullptr, {.id = "other"});
  EXPECT_TRUE(robot_->core().sight().Interests().at(0).in_use);
  robot_->OnInterestAnswer("base", sensor_.get(), {.id = "older"});
  EXPECT_FALSE(robot_->core().sight().Interests().at(0).in_use) << "it watches by another one";
}

TEST_F(RobotCoverageTest, WhatASensorUsesAlreadyNeedsNoAnswer) {
  Start(kCoverageRules);
  sensor_ = std::make_shared<FakeSensor>();
  robot_->OnSensorHello("base", sensor_,
                        {.incarnation = kIncarnation,
                         .clock = clock_.Now(),
                         .interest_in_use = absl::StrCat("interest ", 1)});
  EXPECT_TRUE(robot_->core().sight().Interests().at(0).in_use);
}

TEST_F(RobotCoverageTest, MessagesThatWereLostCountInTheWindowsOfTheirTopic) {
  Begin();
  const int64_t now = Boottime();
  Lose({.count = 4,
        .topic = "/cmd_vel",
        .type = "geometry_msgs/msg/Twist",
        .writer = Writer(2),
        .first_ns = now - 500 * kNanosPerMilli,
        .last_ns = now});
  EXPECT_EQ(audience_.Count("flood"), 0);
  SendMessage(2);
  EXPECT_EQ(audience_.Count("flood"), 1);
  EXPECT_EQ(Base().lost, 4u);
}

TEST_F(RobotCoverageTest, OldLossesDoNotCountInTheWindows) {
  Begin();
  Lose({.count = 4,
        .topic = "/cmd_vel",
        .first_ns = Boottime() - 3 * kNanosPerSecond,
        .last_ns = Boottime() - 2 * kNanosPerSecond});
  SendMessage(2);
  EXPECT_EQ(audience_.Count("flood"), 0);
}

TEST_F(RobotCoverageTest, ThreeRestartsWithinTenMinutesAreTold) {
  Begin();
  Restart("incarnation of 2");
  Restart("incarnation of 3");
  Restart("incarnation of 3");
  Pass(100);
  EXPECT_EQ(audience_.Count("restart"), 0);
  Restart("incarnation of 4");
  Pass(100);
  EXPECT_EQ(audience_.Count("sensor base has restarted 3 times"), 1);
  EXPECT_EQ(audience_.Count("rule restarting"), 1);
  ASSERT_FALSE(audience_.alerts.empty());
  EXPECT_EQ(audience_.alerts[0].severity, "high");
}

TEST_F(RobotCoverageTest, AClockThatIsOffIsToldOnce) {
  Begin();
  sensor_heartbeats_ = false;
  const auto heartbeat = [&](int64_t ahead_ms) {
    Pass(500);
    robot_->OnSensorHeartbeat(
        "base", sensor_.get(),
        {.clock = {.boottime_ns = Boottime(),
                   .unix_ns = clock_.Now().unix_ns + ahead_ms * kNanosPerMilli},
         .echo_boottime_ns = Boottime()});
    Pass(50);
  };
  for (int i = 0; i < 10; ++i) heartbeat(10'000);
  EXPECT_EQ(audience_.Count("wall clock of sensor base is off by about 10000 ms"), 1);
  EXPECT_EQ(audience_.Count("rule skew"), 1);
  EXPECT_EQ(Base().clock_skew_ns, 10 * kNanosPerSecond);
  for (int i = 0; i < 10; ++i) heartbeat(0);
  EXPECT_EQ(Base().clock_skew_ns, 0);
  EXPECT_EQ(audience_.Count("rule skew"), 1) << "it is silent when it is over";
}

TEST_F(RobotCoverageTest, AnOverloadedSensorIsToldWhenItBegins) {
  Begin();
  SendState({.overloaded = true, .outbox_bytes = 7, .spool_bytes = 9});
  SendState({.overloaded = true});
  EXPECT_EQ(audience_.Count("rule overloaded"), 1);
  EXPECT_TRUE(Base().state.overloaded);
  SendState({});
  SendState({.overloaded = true, .outbox_bytes = 7, .spool_bytes = 9});
  EXPECT_EQ(audience_.Count("rule overloaded"), 2);
  EXPECT_EQ(Base().state.outbox_bytes, 7u);
  EXPECT_EQ(Base().state.spool_bytes, 9u);
}

TEST_F(RobotCoverageTest, EndpointsThatBecomeInvisibleAreToldTogether) {
  Begin();
  AddWriter(11, ros2::EndpointKind::kPublisher, ros2::Visibility::kNotVisible);
  AddWriter(12, ros2::EndpointKind::kPublisher, ros2::Visibility::kNotVisible);
  AddWriter(13, ros2::EndpointKind::kPublisher, ros2::Visibility::kWatched);
  AddWriter(14, ros2::EndpointKind::kPublisher, ros2::Visibility::kNotNeeded);
  Pass(1'000);
  EXPECT_EQ(audience_.Count("less is seen: 2 endpoints are not visible, 0 were"), 1);
  EXPECT_THAT(audience_.alerts, SizeIs(1));
  EXPECT_EQ(audience_.alerts[0].severity, "medium");
  EXPECT_EQ(audience_.alerts[0].rule, "(rips)");
}

TEST_F(RobotCoverageTest, ServicesThatAreNeverReadAreNotTold) {
  Begin();
  AddWriter(11, ros2::EndpointKind::kService, ros2::Visibility::kNotVisible);
  AddWriter(12, ros2::EndpointKind::kClient, ros2::Visibility::kNotVisible);
  Pass(1'000);
  EXPECT_THAT(audience_.alerts, IsEmpty());
}

TEST_F(RobotCoverageTest, EndpointsOfRipsItselfAreNotTold) {
  Begin();
  ConnectActuator({.effective_level = "DEFAULT", .participant = Participant(11)});
  AddWriter(11, ros2::EndpointKind::kPublisher, ros2::Visibility::kNotVisible);
  Pass(1'000);
  EXPECT_EQ(audience_.Count("less is seen"), 0);
}

TEST_F(RobotCoverageTest, ANewKindOfInvisibleTrafficIsTold) {
  Start(kCoverageRules);
  sensor_ = std::make_shared<FakeSensor>();
  robot_->OnSensorHello("base", sensor_,
                        {.incarnation = kIncarnation,
                         .clock = clock_.Now(),
                         .not_visible = {"unicast-only writers"}});
  SendSnapshot();
  Pass(1'000);
  EXPECT_EQ(audience_.Count("less is seen"), 0) << "what it says at first is no fall";
  EXPECT_THAT(Base().state.not_visible, ElementsAre("unicast-only writers"));
  SendState({.not_visible = {"unicast-only writers", "shared memory"}});
  Pass(1'000);
  EXPECT_EQ(audience_.Count("less is seen: sensor base does not see shared memory"), 1);
  SendState({});
  EXPECT_THAT(Base().state.not_visible, IsEmpty());
}

TEST_F(RobotCoverageTest, CoverageListsEverySensorOfTheInventory) {
  Start(kCoverageRules);
  EXPECT_FALSE(Base().connected);
  EXPECT_TRUE(Base().primary);
  EXPECT_FALSE(Base().settled);
  ConnectSensor();
  EXPECT_TRUE(Base().connected);
  EXPECT_FALSE(Base().settled);
  SendSnapshot();
  EXPECT_TRUE(Base().settled);
  EXPECT_EQ(Base().host, "base");
  Pass(600);
  EXPECT_EQ(Base().clock_skew_ns, 0);
  Lose({.count = 7, .cause = "queue full"});
  EXPECT_EQ(Base().lost, 7u);
  robot_->OnSensorGone("base", sensor_.get());
  EXPECT_FALSE(Base().connected);
  EXPECT_EQ(Base().clock_skew_ns, std::nullopt);
  EXPECT_EQ(Base().lost, 7u);
}

}  // namespace
}  // namespace rips::pipeline
