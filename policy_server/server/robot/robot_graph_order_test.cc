// Messages and the graph come on two lanes without order: neither a robot that boots nor one that
// stops looks like an attack, and nothing waits for ever.
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"

namespace rips::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Pair;

constexpr char kSenderRules[] = R"(
levels:
  DEFAULT;
  ALERT;
  COMPROMISED;
  HALT;
rules Msg:
  stranger: topicin("/cmd_vel") && !senderin("/navigator") ? trigger(COMPROMISED);
rules External:
  others: false ? trigger(ALERT), trigger(HALT);
)";

constexpr char kLooseRules[] = R"(
levels:
  DEFAULT;
  ALERT;
  COMPROMISED;
  HALT;
rules Msg:
  rogue: topicin("/cmd_vel") && !publishers("/navigator") ? alert("rogue cmd_vel", "critical");
rules External:
  others: false ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);
)";

class GraphOrderTest : public RobotTest {
 protected:
  // A Twist of `writer` that names a version of the graph.
  static Observation Drive(uint8_t writer, uint64_t version,
                           absl::string_view sender = "/navigator") {
    return {.what = MessageSeen{.topic = "/cmd_vel",
                                .type = "geometry_msgs/msg/Twist",
                                .sender = sender,
                                .writer = Writer(writer),
                                .size_bytes = 52,
                                .graph_version = version}};
  }
  // A batch of messages of a process of the sensor that is over, and the graph that it brings.
  void SendFormer(uint64_t sequence, std::vector<Observation> messages,
                  std::vector<GraphChange> graph = {},
                  const std::string& incarnation = "fedcba9876543210") {
    for (Observation& each : messages) each.boottime_ns = Boottime();
    robot_->OnBatch("base", sensor_.get(),
                    std::make_shared<const Batch>(Batch{.incarnation = incarnation,
                                                        .lane = Lane::kMessages,
                                                        .first_sequence = sequence,
                                                        .observations = std::move(messages),
                                                        .graph = std::move(graph),
                                                        .bytes = 100}));
    Drain();
    Pass(100);
  }
  // Steps of the graph of such a process that no server had judged when it ended; announced are as
  // many as the test says.
  void SendFormerSteps(uint64_t sequence, std::vector<GraphChange> steps) {
    std::vector<Observation> observations;
    for (GraphChange& step : steps) {
      observations.push_back({.boottime_ns = Boottime(), .what = std::move(step)});
    }
    robot_->OnBatch("base", sensor_.get(),
                    std::make_shared<const Batch>(Batch{.incarnation = "fedcba9876543210",
                                                        .lane = Lane::kControl,
                                                        .first_sequence = sequence,
                                                        .observations = std::move(observations),
                                                        .bytes = 100}));
    Drain();
  }
  static SpooledRange FormerSteps(uint64_t last) {
    return {.incarnation = "fedcba9876543210",
            .lane = Lane::kControl,
            .first_sequence = 1,
            .last_sequence = last};
  }
  static GraphChange NormalThen(uint64_t version) {
    return {.to_version = version, .settled = true, .delta = NormalGraph()};
  }
  static GraphChange IntruderJoins(uint64_t from) {
    GraphChange joins{.from_version = from, .to_version = from + 1, .settled = true};
    AddNode(&joins.delta, 9, "/intruder");
    return joins;
  }
  static GraphChange IntruderLeft(uint64_t from) {
    GraphChange left{.from_version = from, .to_version = from + 1, .settled = true};
    left.delta.gone_guids = {Participant(9)};
    return left;
  }
  // The sensor is started anew, beside a robot at DEFAULT; with these in its spool.
  void StartAnew(std::vector<SpooledRange> spooled) {
    Start();
    Arm();
    robot_->OnSensorGone("base", sensor_.get());
    Drain();
    next_sequence_[0] = next_sequence_[1] = 1;
    sensor_ = std::make_shared<FakeSensor>();
    robot_->OnSensorHello(
        "base", sensor_,
        {.incarnation = "another process!", .clock = clock_.Now(), .spooled = std::move(spooled)});
    AnswerInterest();
    Drain();
  }
  void SendOwnGraph(ros2::GraphDelta graph) {
    robot_->OnBatch(
        "base", sensor_.get(),
        std::make_shared<const Batch>(Batch{
            .incarnation = "another process!",
            .lane = Lane::kControl,
            .first_sequence = 1,
            .observations = {{.boottime_ns = Boottime(),
                              .what =
                                  GraphChange{.to_version = 1, .settled = true, .delta = graph}}},
            .bytes = 100}));
    Drain();
  }
  static GraphChange NavigatorThen(uint64_t version) {
    GraphChange whole{.to_version = version, .settled = true};
    AddNode(&whole.delta, 2, "/navigator", "/cmd_vel");
    return whole;
  }
  void ArmWithoutNavigator() {
    ConnectSensor();
    ConnectActuator({.effective_level = "DEFAULT"});
    graph_version_ = 1;
    ros2::GraphDelta graph;
    AddNode(&graph, 1, "/camera");
    SendBatch(Lane::kControl,
              {{.what = GraphChange{.to_version = 1, .settled = true, .delta = graph}}});
    Obey();
    Pass(100);
  }
  void NavigatorComes() {
    ros2::GraphDelta delta;
    AddNode(&delta, 2, "/navigator", "/cmd_vel");
    SendDelta(std::move(delta));
  }
  void NavigatorGoes() {
    ros2::GraphDelta delta;
    delta.gone_guids = {Participant(2)};
    SendDelta(std::move(delta));
  }
};

TEST_F(GraphOrderTest, AMessageThatOvertakesItsGraphWaitsForIt) {
  Start();
  ArmWithoutNavigator();

  SendBatch(Lane::kMessages, {Drive(2, 2)});
  Pass(100);
  EXPECT_EQ(recorder_.high_water.size(), 1u) << "it is not judged yet, so not acknowledged";
  NavigatorComes();
  Pass(1'000);

  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(audience_.Count("rogue"), 0);
  EXPECT_EQ(sensor_->acknowledged[static_cast<int>(Lane::kMessages)], 1u);
}

TEST_F(GraphOrderTest, AMessageThatIsOvertakenByTheEndOfItsWriterIsJudgedAgainstItsOwnTime) {
  Start();
  Arm();
  NavigatorGoes();
  SendBatch(Lane::kMessages, {Drive(2, 1)});
  Pass(600);

  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(audience_.Count("rogue"), 0);
  EXPECT_EQ(robot_->core().graph().FindEndpoint(Writer(2)), nullptr)
      << "the newest graph is in force";
}

TEST_F(GraphOrderTest, WhatWaitedTooLongIsJudgedAsUnattributedWithTheReason) {
  uint64_t unattributed = 0;
  counts_.messages_unattributed = [&](uint64_t by) { unattributed += by; };
  Start();
  ArmWithoutNavigator();

  SendBatch(Lane::kMessages, {Drive(2, 5)});
  Pass(450);
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(unattributed, 0u);
  Pass(100);

  EXPECT_EQ(Level(), "COMPROMISED");
  EXPECT_EQ(unattributed, 1u);
  ASSERT_EQ(audience_.Count("rogue"), 1);
  for (const auto& alert : audience_.alerts) {
    if (alert.text != "rogue cmd_vel") continue;
    EXPECT_THAT(alert.event, AllOf(HasSubstr("(unattributed "), HasSubstr("within 500 ms"),
                                   HasSubstr("version 5 was to show it, version 1 is in force")));
  }
}

TEST_F(GraphOrderTest, WhatOutlivedItsGraphIsJudgedByTheGraphOfNowAndItsWriter) {
  Start();
  ArmWithoutNavigator();
  SendFormer(1, {Drive(2, 5)});
  EXPECT_EQ(Level(), "DEFAULT") << "the navigator drove, and has stopped since";
  EXPECT_EQ(audience_.Count("rogue"), 0);
  NavigatorComes();
  SendFormer(2, {Drive(3, 5, "/rogue")});
  EXPECT_EQ(Level(), "COMPROMISED") << "that only the navigator is left does not excuse it";
  ASSERT_EQ(audience_.Count("rogue"), 1);
  EXPECT_THAT(
      audience_.alerts.back().event,
      AllOf(HasSubstr("/rogue"), HasSubstr("who was there when it was taken is not known")));
}

TEST_F(GraphOrderTest, ALateMessageOfAnUnattributedWriterIsUnauthorised) {
  Start();
  Arm();
  SendFormer(1, {Drive(3, 5, "")});
  EXPECT_EQ(Level(), "COMPROMISED");
}

TEST_F(GraphOrderTest, WhatOutlivedItsGraphIsJudgedByTheGraphThatItBrings) {
  Start();
  ArmWithoutNavigator();
  const uint64_t in_force = robot_->core().graph().endpoints().size();
  // The graph knows better who writes than the message does.
  SendFormer(1, {Drive(2, 5, "/other")}, {NavigatorThen(5)});
  SendFormer(2, {Drive(2, 5, "/other")});
  ros2::GraphDelta joins;
  AddNode(&joins, 3, "/camera_2", "/image");
  SendFormer(3, {Drive(2, 6, "/other")}, {{.from_version = 5, .to_version = 6, .delta = joins}});
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(audience_.Count("rogue"), 0);
  EXPECT_EQ(robot_->core().graph().endpoints().size(), in_force) << "it is not in force";
}

TEST_F(GraphOrderTest, WhoWasNotAllowedThenIsAccusedLater) {
  Start();
  Arm();
  ros2::GraphDelta rogue;
  AddNode(&rogue, 2, "/navigator", "/cmd_vel");
  AddNode(&rogue, 3, "/rogue", "/cmd_vel");
  SendFormer(1, {Drive(3, 5)}, {{.to_version = 5, .settled = true, .delta = rogue}});
  EXPECT_EQ(Level(), "COMPROMISED");
  ASSERT_EQ(audience_.Count("rogue"), 1);
  EXPECT_THAT(audience_.alerts.back().event, HasSubstr("/rogue"));
}

TEST_F(GraphOrderTest, AGraphOfAnotherTimeOrProcessAndOneThatDoesNotFitIsNotUsed) {
  Start(kLooseRules);
  ArmWithoutNavigator();
  SendFormer(1, {Drive(2, 5, "/other")}, {NavigatorThen(5)});
  EXPECT_EQ(audience_.Count("rogue"), 0);
  SendFormer(2, {Drive(2, 6, "/other")});
  EXPECT_EQ(audience_.Count("rogue"), 1) << "of a later version than what came";
  SendFormer(1, {Drive(2, 5, "/other")}, {}, "an older process");
  EXPECT_EQ(audience_.Count("rogue"), 2);
  SendFormer(3, {Drive(2, 5, "/other")}, {{.from_version = 8, .to_version = 9}});
  EXPECT_EQ(audience_.Count("rogue"), 3) << "a step was lost";
  GraphChange broken = NavigatorThen(10);
  broken.delta.upsert_participants.clear();
  SendFormer(4, {Drive(2, 5, "/other")}, {broken});
  EXPECT_EQ(audience_.Count("rogue"), 4) << "it contradicts itself";
  SendFormer(5, {Drive(2, 5, "/other")}, {NavigatorThen(11)});
  EXPECT_EQ(audience_.Count("rogue"), 4) << "a snapshot makes it known again";
}

TEST_F(GraphOrderTest, WhoCameAndWentBeforeTheSensorWasStartedAnewIsTold) {
  StartAnew({FormerSteps(3)});
  SendOwnGraph(NormalGraph());
  Pass(100);
  SendFormerSteps(1, {NormalThen(7), IntruderJoins(7)});
  EXPECT_EQ(Level(), "ALERT");
  ASSERT_EQ(audience_.Count("unknown node"), 1);
  EXPECT_THAT(recorder_.decisions.back().reason, HasSubstr("graph change, taken at 20"));
  EXPECT_THAT(audience_.alerts.back().event,
              AllOf(HasSubstr(", taken at 20"), HasSubstr("it came late")));
  EXPECT_EQ(robot_->core().graph().nodes().size(), 2u) << "it is not in force";
  Pass(60'000);
  EXPECT_EQ(Level(), "ALERT") << "the rest of the backlog has not come";
  EXPECT_THAT(recorder_.variables, Contains(Pair("intruder", lang::Value(true))));

  SendFormerSteps(3, {IntruderLeft(8)});
  Pass(1'000);
  EXPECT_THAT(recorder_.variables, Contains(Pair("intruder", lang::Value(false))));
  EXPECT_EQ(Level(), "ALERT") << "what came late is no evidence";
  Obey();
  Pass(60'000);
  EXPECT_EQ(Level(), "DEFAULT") << "he has gone";
  EXPECT_EQ(audience_.Count("unknown node"), 1);
}

TEST_F(GraphOrderTest, WhoWasThereWhenTheSensorEndedIsLookedForInTheNextGraph) {
  StartAnew({FormerSteps(2)});
  SendFormerSteps(1, {NormalThen(7), IntruderJoins(7)});
  Pass(1'000);
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_THAT(recorder_.variables, Contains(Pair("intruder", lang::Value(true))))
      << "the graph in force is older than what came late";
  ros2::GraphDelta graph = NormalGraph();
  AddNode(&graph, 9, "/intruder");
  SendOwnGraph(std::move(graph));
  Pass(60'000);
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_THAT(recorder_.variables, Contains(Pair("intruder", lang::Value(true))));
}

TEST_F(GraphOrderTest, OfManyFormerGraphsInOneBatchTheLastIsJudged) {
  uint64_t merged = 0;
  counts_.graphs_merged = [&](uint64_t by) { merged += by; };
  StartAnew({FormerSteps(10)});
  SendOwnGraph(NormalGraph());
  std::vector<GraphChange> steps = {NormalThen(1)};
  for (uint64_t version = 1; version < 9; ++version) {
    steps.push_back({.from_version = version, .to_version = version + 1, .settled = true});
  }
  steps.push_back(IntruderJoins(9));
  SendFormerSteps(1, std::move(steps));
  EXPECT_GT(merged, 0u);
  EXPECT_EQ(audience_.Count("unknown node"), 1);
}

TEST_F(GraphOrderTest, AStepThatWasJudgedBeforeIsWhatTheNextGoesOnFrom) {
  StartAnew({FormerSteps(3)});
  SendOwnGraph(NormalGraph());
  SendFormerSteps(1, {NormalThen(7)});
  // Another connection brings the batch once more, as it was spooled.
  SendFormerSteps(1, {NormalThen(7), IntruderJoins(7), IntruderLeft(8)});
  EXPECT_EQ(audience_.Count("unknown node"), 1);
  Pass(1'000);
  EXPECT_EQ(audience_.Count("do not fit one another"), 0);
}

TEST_F(GraphOrderTest, AnotherSensorOfTheRobotCannotPutAGraphInItsPlace) {
  sensor_hosts_ = {"base", "laptop"};
  StartAnew({FormerSteps(3)});
  ros2::GraphDelta camera;
  AddNode(&camera, 1, "/camera");
  SendOwnGraph(std::move(camera));
  const auto laptop = std::make_shared<FakeSensor>();
  robot_->OnSensorHello("laptop", laptop, {.incarnation = kIncarnation, .clock = clock_.Now()});
  const auto invent = [&](Lane lane, uint64_t sequence) {
    Batch batch{
        .incarnation = "0 of the laptop!", .lane = lane, .first_sequence = sequence, .bytes = 100};
    const Observation graph{.boottime_ns = Boottime(), .what = NormalThen(99)};
    batch.observations = {lane == Lane::kControl ? graph : Drive(2, 99)};
    if (lane == Lane::kMessages) batch.graph = {NormalThen(99)};
    robot_->OnBatch("laptop", laptop.get(), std::make_shared<const Batch>(std::move(batch)));
    Drain();
  };
  SendFormerSteps(1, {NormalThen(7)});
  invent(Lane::kControl, 1);
  invent(Lane::kControl, 1);  // judged before
  SendFormerSteps(2, {IntruderJoins(7), IntruderLeft(8)});
  EXPECT_EQ(audience_.Count("unknown node"), 1);
  EXPECT_EQ(audience_.Count("do not fit one another"), 0);

  const auto former = [&](uint64_t sequence, uint64_t version, std::vector<GraphChange> graph) {
    SendFormer(sequence, {Drive(2, version, "/other")}, std::move(graph));
  };
  former(1, 5, {NormalThen(5)});
  invent(Lane::kMessages, 1);
  former(2, 6, {{.from_version = 5, .to_version = 6, .settled = true}});
  EXPECT_EQ(audience_.Count("rogue"), 0);
}

TEST_F(GraphOrderTest, WhatDoesNotGoOnFromAnythingIsLost) {
  StartAnew({FormerSteps(2)});
  SendOwnGraph(NormalGraph());
  SendFormerSteps(1, {IntruderJoins(7), IntruderLeft(8)});
  EXPECT_EQ(Level(), "DEFAULT");
  Pass(1'000);
  EXPECT_EQ(audience_.Count("do not fit one another"), 1);
}

TEST_F(GraphOrderTest, WhatTheRulesKeepOfALateMessageIsLookedAtAgain) {
  Start(R"(
levels:
  DEFAULT;
  ALERT;
  COMPROMISED;
  HALT;
vars:
  driver bool = false;
rules Graph:
  gone: topicpublishersinclude("/cmd_vel", "/navigator") && driver ?
    set(driver, false) => alert("gone", "info");
rules Msg:
  rogue: topicin("/cmd_vel") && !publishers("/navigator") ?
    set(driver, true) => alert("rogue cmd_vel", "critical");
rules External:
  others: false ? trigger(ALERT), trigger(COMPROMISED), trigger(HALT);
)");
  Arm();
  ros2::GraphDelta rogue;
  AddNode(&rogue, 3, "/rogue", "/cmd_vel");
  SendDelta(std::move(rogue));
  ros2::GraphDelta gone;
  gone.gone_guids = {Participant(3)};
  SendDelta(std::move(gone));
  SendBatch(Lane::kMessages, {Drive(3, 2), Drive(3, 2)});
  Pass(1'100);
  EXPECT_EQ(audience_.Count("rogue"), 2);
  EXPECT_THAT(recorder_.variables, Contains(Pair("driver", lang::Value(false))))
      << "it has gone, and no graph comes that would say so";
  EXPECT_EQ(audience_.Count("gone"), 1);

  for (int i = 0; i < 3; ++i) {
    SendBatch(Lane::kMessages, {Drive(3, 2)});
    Pass(300);
  }
  EXPECT_EQ(audience_.Count("gone"), 1);
  Pass(500);
  EXPECT_EQ(audience_.Count("rogue"), 5);
  EXPECT_EQ(audience_.Count("gone"), 2) << "not after each batch";
}

TEST_F(GraphOrderTest, AProcessThatComesBackAfterAnotherIsAskedForItsGraph) {
  Start();
  Arm();
  robot_->OnSensorGone("base", sensor_.get());
  const auto thief = std::make_shared<FakeSensor>();
  robot_->OnSensorHello("base", thief, {.incarnation = "a stolen key too", .clock = clock_.Now()});
  robot_->OnSensorGone("base", thief.get());
  Drain();
  ConnectSensor();
  EXPECT_TRUE(sensor_->setup.want_snapshot) << "it is not settled, and may never change";
  SendSnapshot();
  IntruderAppears();
  EXPECT_EQ(Level(), "ALERT") << "what it sees is judged";
}

TEST_F(GraphOrderTest, OnlyWhatIsBehindAWaitingMessageWaitsWithIt) {
  Start(kSenderRules);
  Arm();
  // Of one batch: a known writer, then one whose graph has not come.
  SendBatch(Lane::kMessages, {Drive(2, 1), Drive(9, 2), Drive(2, 1)});
  EXPECT_EQ(Level(), "DEFAULT");
  Pass(550);

  EXPECT_EQ(Level(), "COMPROMISED") << "9 is nobody";
  Pass(1'000);
  EXPECT_EQ(sensor_->acknowledged[static_cast<int>(Lane::kMessages)], 3u);
}

TEST_F(GraphOrderTest, WhatStandsBeforeAWaitingMessageIsJudgedAtOnce) {
  Start();
  Arm();
  ros2::GraphDelta delta;
  AddNode(&delta, 3, "/intruder", "/cmd_vel");
  SendDelta(std::move(delta));
  SendBatch(Lane::kMessages, {Drive(3, 2), Drive(9, 7)});
  EXPECT_EQ(Level(), "COMPROMISED");
}

TEST_F(GraphOrderTest, WaitsOverlapAndAnEndlessStreamOfUnknownWritersDelaysByOneWait) {
  Start();
  Arm();
  for (uint8_t i = 0; i < 20; ++i) {
    SendBatch(Lane::kMessages, {Drive(static_cast<uint8_t>(100 + i), 9)});
    Pass(50);
  }
  // The last came 50 ms ago: it has its wait to go, and the next checkpoint.
  Pass(500 + 1'000);
  EXPECT_EQ(sensor_->acknowledged[static_cast<int>(Lane::kMessages)], 20u);
}

TEST_F(GraphOrderTest, AClockOfTheFutureDoesNotMakeAMessageWaitLonger) {
  Start(kSenderRules);
  Arm();
  Observation message = Drive(9, 7);
  message.boottime_ns = Boottime() + 3'600 * kNanosPerSecond;
  SendBatch(Lane::kMessages, {message});
  Pass(600);
  EXPECT_EQ(Level(), "COMPROMISED");
}

TEST_F(GraphOrderTest, AWaitingMessageDoesNotMakeASilentSensorLookAlive) {
  Start();
  Arm();
  SendBatch(Lane::kMessages, {Drive(9, 7)});
  sensor_heartbeats_ = false;
  Pass(6'500);
  EXPECT_FALSE(sensor_->closed.ok());
}

TEST_F(GraphOrderTest, AMessageThatWaitsWhenTheStreamEndsIsNotAcknowledged) {
  Start();
  ArmWithoutNavigator();
  SendBatch(Lane::kMessages, {Drive(2, 2)});
  robot_->OnSensorGone("base", sensor_.get());
  Pass(1'000);
  EXPECT_EQ(Level(), "DEFAULT") << "it will be sent again";
  EXPECT_EQ(sensor_->acknowledged[static_cast<int>(Lane::kMessages)], 0u);
}

TEST_F(GraphOrderTest, FiftyStartsAndStopsOfTheDriverRaiseNothing) {
  Start();
  ArmWithoutNavigator();
  for (int i = 0; i < 50; ++i) {
    // Whichever lane is first, at the start and at the end.
    const bool overtakes = i % 2 == 0;
    if (overtakes) SendBatch(Lane::kMessages, {Drive(2, graph_version_ + 1)});
    NavigatorComes();
    if (!overtakes) SendBatch(Lane::kMessages, {Drive(2, graph_version_)});
    Pass(50);
    const uint64_t then = graph_version_;
    NavigatorGoes();
    SendBatch(Lane::kMessages, {Drive(2, then)});
    Pass(50);
  }
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(audience_.Count("rogue"), 0);
}

}  // namespace
}  // namespace rips::pipeline
