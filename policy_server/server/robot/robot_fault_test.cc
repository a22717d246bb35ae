// What goes wrong around one robot: lost, late, repeated, reordered, malformed. The level never
// goes down because of it.
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr char kExecRules[] = R"(
levels:
  DEFAULT;
  HALT;
rules Graph:
  R: nodecount(3, 100) ? {
    alert("info: rule R activated");
    exec("usb_alarm") !> alert("warning: usb_alarm failed");
    trigger(HALT);
  }
)";

TEST_F(RobotTest, JudgesAnObservationOnceHoweverOftenItComes) {
  Start();
  Arm();
  SendMessage(2);
  next_sequence_[static_cast<int>(Lane::kMessages)] = 1;

  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder", "/cmd_vel");
  SendDelta(std::move(delta));
  const size_t alerts = audience_.alerts.size();
  SendMessage(9);  // sequence 1 again: judged before the intruder came

  EXPECT_EQ(audience_.Count("rogue"), 0);
  EXPECT_EQ(audience_.alerts.size(), alerts);
  SendMessage(9);
  EXPECT_EQ(audience_.Count("rogue"), 1);
}

TEST_F(RobotTest, AGapInTheControlLaneEndsTheStream) {
  Start();
  Arm();
  next_sequence_[0] = 40;

  SendDelta({});

  EXPECT_THAT(sensor_->closed,
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is missing")));
  EXPECT_THAT(robot_->Status().degraded, Contains(HasSubstr("sensor base is not connected")));
}

TEST_F(RobotTest, AGapInTheMessageLaneIsLossAndMakesBlind) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  IntruderLeaves();
  Pass(4'000);
  next_sequence_[1] = 100;

  SendMessage(2);
  Pass(2'000);

  EXPECT_THAT(sensor_->closed, IsOk());
  EXPECT_EQ(Level(), "ALERT") << "soft_hold starts anew";
  Pass(4'000);
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(RobotTest, OlderIncarnationsAreJudgedAndAcknowledgedForThemselves) {
  const std::string former(16, 'f');
  Start();
  ConnectSensor(
      {{.incarnation = former, .lane = Lane::kControl, .first_sequence = 1, .last_sequence = 2}});
  ConnectActuator({.effective_level = "DEFAULT"});
  SendSnapshot();
  Obey();
  EXPECT_THAT(robot_->Status().degraded, Contains(HasSubstr("not judged yet")));
  const auto graph = robot_->core().graph().nodes();
  ros2::GraphDelta old;
  AddNode(&old, 7, "/long_gone");

  robot_->OnBatch(
      "base", sensor_.get(),
      std::make_shared<const Batch>(Batch{
          .incarnation = former,
          .lane = Lane::kControl,
          .first_sequence = 1,
          .observations = {{.what = GraphChange{.to_version = 1, .settled = true, .delta = old}},
                           {.what = SignalSeen{.name = "SIGUSR1"}}}}));
  Drain();
  Pass(2'000);

  EXPECT_THAT(sensor_->closed, IsOk());
  EXPECT_EQ(recorder_.high_water.size(), 2u);
  EXPECT_EQ(robot_->core().graph().nodes(), graph) << "the graph of an incarnation that is over";
  EXPECT_THAT(robot_->Status().degraded, Not(Contains(HasSubstr("not judged yet"))));
}

TEST_F(RobotTest, AnnouncedIncarnationsAreNotForgottenForOthers) {
  Start();
  std::vector<SpooledRange> spooled;
  for (size_t i = 0; i < SequenceTrack::kIncarnationsMax - 2; ++i) {
    spooled.push_back({.incarnation = std::string(16, static_cast<char>('A' + i)),
                       .lane = Lane::kMessages,
                       .first_sequence = 11,
                       .last_sequence = 20});
  }
  ConnectSensor(spooled);
  SendSnapshot();
  robot_->OnSensorGone("base", sensor_.get());

  ConnectSensor({{.incarnation = std::string(16, 'A'),
                  .lane = Lane::kMessages,
                  .first_sequence = 1,
                  .last_sequence = 20}});

  EXPECT_EQ(sensor_->acknowledged[1], 10u) << "what came before the range will not come";
}

TEST_F(RobotTest, ADeltaThatDoesNotFitEndsTheStreamAndASnapshotIsAskedFor) {
  Start();
  Arm();
  graph_version_ = 17;

  SendDelta({});

  EXPECT_THAT(sensor_->closed, StatusIs(absl::StatusCode::kInvalidArgument));
  ConnectSensor();
  EXPECT_TRUE(sensor_->setup.want_snapshot);
  EXPECT_EQ(sensor_->granted, 0u) << "no messages before there is a graph";
}

TEST_F(RobotTest, AGraphWithUnknownReferencesEndsTheStream) {
  Start();
  Arm();
  ros2::GraphDelta delta;
  delta.upsert_nodes.push_back({.full_name = "/ghost", .participant = Participant(77)});

  SendDelta(std::move(delta));

  EXPECT_THAT(sensor_->closed, StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_EQ(robot_->core().graph().nodes().size(), 2u) << "nothing of it was taken";
}

TEST_F(RobotTest, KeepsTheGraphOfTheSameIncarnationAcrossReconnects) {
  Start();
  Arm();
  robot_->OnSensorGone("base", sensor_.get());

  ConnectSensor();

  EXPECT_FALSE(sensor_->setup.want_snapshot);
  EXPECT_GT(sensor_->granted, 0u);
}

TEST_F(RobotTest, JudgesAnUnsettledGraphOnlyWhenItHasSettled) {
  Start();
  ConnectSensor();
  ConnectActuator({.effective_level = "DEFAULT"});
  ros2::GraphDelta graph = NormalGraph();
  AddNode(&graph, 9, "/intruder");

  SendBatch(Lane::kControl,
            {{.what = GraphChange{.to_version = 1, .settled = false, .delta = graph}}});
  EXPECT_EQ(Level(), "DEFAULT");
  graph_version_ = 1;
  SendDelta({});

  EXPECT_EQ(Level(), "ALERT") << "the whole snapshot is judged when discovery has settled";
}

TEST_F(RobotTest, ASilentSensorIsLostAndTheLevelStays) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  IntruderLeaves();
  sensor_heartbeats_ = false;

  Pass(30'000);

  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(audience_.Count("sensor base is lost"), 1);
  EXPECT_THAT(sensor_->closed, StatusIs(absl::StatusCode::kDeadlineExceeded));
}

TEST_F(RobotTest, ASensorThatNeverConnectedIsLostToo) {
  Start();

  Pass(5'200);

  EXPECT_EQ(audience_.Count("sensor base is lost"), 1);
  EXPECT_EQ(audience_.Count("actuator base has not connected since this server started"), 1);
}

TEST_F(RobotTest, ARaiseThatNoActuatorHearsOfIsACriticalAlert) {
  Start();
  Arm();
  actuator_heartbeats_ = false;
  Pass(20'000);
  ASSERT_EQ(audience_.Count("if it has ended, r1 stays as it is"), 1);
  IntruderAppears();
  Pass(1'000);
  EXPECT_EQ(audience_.Count("is not in force on actuator base"), 0) << "it may come back";
  Pass(20'000);
  EXPECT_EQ(audience_.Count("level ALERT is not in force on actuator base"), 1);

  actuator_heartbeats_ = true;
  ConnectActuator({.effective_level = "DEFAULT"});
  Drain();
  Obey();
  Pass(20'000);
  EXPECT_EQ(audience_.Count("is not in force"), 1);
}

TEST_F(RobotTest, ALevelThatWasReachedStaysSoInTheHistory) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  ASSERT_EQ(recorder_.stages.back().stage, "verified");
  const DecisionId reached = recorder_.stages.back().decision_id;
  actuator_heartbeats_ = false;
  Pass(20'000);
  robot_->Raise({.operator_name = "alice", .to = "HALT", .reason = "drill"},
                [](const LevelAnswer&) {});
  Drain();
  for (const store::StageUpdate& each : recorder_.stages) {
    EXPECT_FALSE(each.decision_id == reached && each.stage == "superseded");
  }
}

TEST_F(RobotTest, ASilentActuatorMakesBlind) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  IntruderLeaves();
  actuator_heartbeats_ = false;

  Pass(30'000);

  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(audience_.Count("actuator base is lost"), 1);
}

TEST_F(RobotTest, ASecondLiveSessionIsRefusedAndASilentOneReplaced) {
  Start();
  Arm();
  const auto first = sensor_;

  ConnectSensor();
  EXPECT_THAT(sensor_->closed, StatusIs(absl::StatusCode::kAlreadyExists));

  sensor_ = first;
  sensor_heartbeats_ = false;
  Pass(1'600);
  ConnectSensor();
  EXPECT_THAT(sensor_->closed, IsOk());
  EXPECT_THAT(first->closed, StatusIs(absl::StatusCode::kAborted));
}

TEST_F(RobotTest, ASecondHolderOfASensorsKeyIsToldOnceAMinuteWithItsAddress) {
  Start();
  Arm();
  for (int i = 0; i < 5; ++i) {
    FakeSensor second;
    robot_->OnSensorHello(
        "base", std::make_shared<FakeSensor>(),
        {.incarnation = "fedcba9876543210", .clock = clock_.Now(), .peer = "ipv4:10.0.0.66:4711"});
    Pass(100);
  }
  Pass(2'000);
  EXPECT_EQ(audience_.Count("a second process uses the key of sensor r1/base"), 1);
  EXPECT_EQ(audience_.Count("ipv4:10.0.0.66:4711"), 1);
  EXPECT_EQ(audience_.alerts.back().severity, "critical");
}

TEST_F(RobotTest, ASessionFromAnotherAddressIsTold) {
  Start();
  Arm();
  const auto connect = [this](const std::string& peer) {
    sensor_heartbeats_ = false;
    Pass(1'600);
    robot_->OnSensorHello("base", std::make_shared<FakeSensor>(),
                          {.incarnation = "fedcba9876543210", .clock = clock_.Now(), .peer = peer});
  };
  connect("ipv4:10.0.0.7:4711");
  connect("ipv4:10.0.0.7:4712");
  EXPECT_EQ(audience_.Count("now comes from"), 0);

  connect("ipv4:10.0.0.66:4711");
  EXPECT_EQ(audience_.Count("sensor r1/base now comes from ipv4:10.0.0.66:4711, before from "
                            "ipv4:10.0.0.7:4712"),
            1);
  const std::string moved = "sensor base came from another address less than 45 s ago";
  sensor_heartbeats_ = true;
  EXPECT_THAT(robot_->Status().degraded, Contains(moved)) << "who else has the key was not heard";
  Pass(46'000);
  EXPECT_THAT(robot_->Status().degraded, Not(Contains(moved)));
}

// Whoever has the session: the other one may be kept out by what was done.
TEST_F(RobotTest, AnAgentWhoseKeyIsMisusedIsDoubted) {
  Start();
  Arm();
  const std::string doubt = "the key of sensor base is used for what no agent does";
  const auto misuse = [this](bool sensor, const std::string& host) {
    robot_->OnKeyMisused({.sensor = sensor, .host = host, .peer = "ipv4:10.0.0.66:4711"});
  };
  EXPECT_THAT(robot_->Status().degraded, IsEmpty());
  misuse(true, "laptop");
  EXPECT_THAT(robot_->Status().degraded, IsEmpty()) << "no sensor of this robot";
  for (int i = 0; i < 3; ++i) misuse(true, "base");
  EXPECT_EQ(audience_.Count("the key of sensor r1/base is used from ipv4:10.0.0.66:4711 for what "
                            "no agent of RIPS does"),
            1);
  EXPECT_EQ(audience_.alerts.back().severity, "critical");
  EXPECT_THAT(robot_->Status().degraded, Contains(doubt));
  EXPECT_FALSE(robot_->core().findings().known().All());

  sensor_heartbeats_ = false;
  Pass(1'600);
  ConnectSensor();
  sensor_heartbeats_ = true;
  EXPECT_THAT(robot_->Status().degraded, Contains(doubt)) << "the new session may be the thief's";
  Pass(91'000);
  EXPECT_THAT(robot_->Status().degraded, Not(Contains(doubt)));

  misuse(false, "base");
  EXPECT_THAT(robot_->Status().degraded,
              Contains("the key of actuator base is used for what no agent does"));
}

// A store that was restored knows nothing of the decision, and the actuator neither.
TEST_F(RobotTest, WhatAnActuatorWithoutStateFindsIsAdopted) {
  Start();
  ConnectActuator({.effective_level = "ALERT", .state_lost = true, .fail_safe_level = "ALERT"});
  floor_ = "state lost";
  effective_ = "HALT";
  Pass(1'000);
  EXPECT_EQ(Level(), "HALT");
  EXPECT_EQ(audience_.Count("finds r1 at HALT, above what this server decided: adopted"), 1);
}

TEST_F(RobotTest, WhereAnActuatorWithoutStateWasOrderedIsNotAdopted) {
  Start();
  ConnectActuator({.effective_level = "ALERT", .state_lost = true, .fail_safe_level = "ALERT"});
  floor_ = "state lost";
  Pass(500);
  robot_->Raise({.operator_name = "alice", .to = "HALT", .reason = "drill"},
                [](const LevelAnswer&) {});
  Drain();
  Obey();
  Pass(500);
  robot_->DeEscalate({.operator_name = "alice",
                      .to = "DEFAULT",
                      .reason = "over",
                      .expected_level = "HALT",
                      .expected_decision_id = robot_->Status().decision_id,
                      .accept_blind = true},
                     [](const LevelAnswer& answer) { EXPECT_THAT(answer.status, IsOk()); });
  Drain();
  Pass(200);  // on its way
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(audience_.Count("adopted"), 0);
}

TEST_F(RobotTest, AFailSafeLevelIsNotAdopted) {
  Start();
  ConnectActuator({.effective_level = "ALERT", .state_lost = true, .fail_safe_level = "ALERT"});
  floor_ = "state lost";
  effective_ = "ALERT";
  Pass(1'000);
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(RobotTest, AnActuatorWhoseStateWentBackIsTold) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  Pass(100);
  robot_->OnActuatorGone("base", actuator_.get());
  ConnectActuator({.decision_id = {1, 1},
                   .decided_level = "DEFAULT",
                   .effective_level = "DEFAULT",
                   .highest_term = 1});
  EXPECT_EQ(audience_.Count("its state was deleted or went back"), 1);
  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(RobotTest, ATermFarBeyondOursArmsNothingAndRaisesNoTerm) {
  Start();
  ConnectActuator({.decision_id = {uint64_t{1} << 62, 1},
                   .decided_level = "HALT",
                   .effective_level = "HALT",
                   .highest_term = uint64_t{1} << 62});
  EXPECT_THAT(actuator_->closed, StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_EQ(audience_.Count("far beyond ours"), 1);
  ConnectActuator({.effective_level = "DEFAULT", .highest_term = 1});
  EXPECT_THAT(actuator_->closed, IsOk());
}

TEST_F(RobotTest, AnIntrudersParticipantIsNotMadeOurOwn) {
  Start();
  Arm();
  IntruderAppears();
  robot_->OnActuatorGone("base", actuator_.get());
  ConnectActuator({.effective_level = "DEFAULT", .participant = Participant(9)});
  EXPECT_EQ(audience_.Count("that is not believed"), 1);
  EXPECT_THAT(sensor_->setup.own_participants, ::testing::Not(::testing::Contains(Participant(9))));
}

TEST_F(RobotTest, AnEarlierParticipantIsOursForHalfAMinute) {
  Start();
  Arm();
  robot_->OnActuatorGone("base", actuator_.get());
  ConnectActuator({.effective_level = "DEFAULT", .participant = Participant(40)});
  robot_->OnActuatorGone("base", actuator_.get());
  ConnectActuator({.effective_level = "DEFAULT", .participant = Participant(41)});
  EXPECT_THAT(sensor_->setup.own_participants,
              ::testing::IsSupersetOf({Participant(40), Participant(41)}));
  Pass(31'000);
  EXPECT_THAT(sensor_->setup.own_participants, ::testing::Contains(Participant(41)));
  EXPECT_THAT(sensor_->setup.own_participants,
              ::testing::Not(::testing::Contains(Participant(40))));
}

TEST_F(RobotTest, ARaiseIsAnsweredWhenTheReserveHasIt) {
  Start();
  Arm();
  recorder_.fail = absl::ResourceExhaustedError("disk full");
  recorder_.reserve = true;
  LevelAnswer answer{.status = absl::UnknownError("not answered")};
  robot_->Raise({.operator_name = "alice", .to = "HALT", .reason = "r", .request_id = "1"},
                [&](const LevelAnswer& got) { answer = got; });
  Drain();
  EXPECT_THAT(answer.status, IsOk());
}

TEST_F(RobotTest, AServerThatStopsAnswersWhoWaitsForTheDisk) {
  Start();
  Arm();
  recorder_.held = true;
  LevelAnswer answer{.status = absl::UnknownError("not answered")};
  const LevelOrder order{.operator_name = "alice", .to = "HALT", .reason = "r", .request_id = "1"};
  robot_->Raise(order, [&](const LevelAnswer& got) { answer = got; });
  robot_->Drain();
  EXPECT_THAT(answer.status, StatusIs(absl::StatusCode::kUnavailable));
  robot_->Raise({.operator_name = "alice", .to = "HALT", .reason = "r", .request_id = "2"},
                [&](const LevelAnswer& got) { answer = got; });
  EXPECT_THAT(answer.status, StatusIs(absl::StatusCode::kUnavailable, "the server is stopping"));
}

TEST_F(RobotTest, ASecondHolderOfAnActuatorsKeyIsTold) {
  Start();
  Arm();
  robot_->OnActuatorHello("base", std::make_shared<FakeActuator>(),
                          {.levels = {"DEFAULT", "ALERT", "COMPROMISED", "HALT"},
                           .clock = clock_.Now(),
                           .peer = "ipv4:10.0.0.66:4711"});
  Pass(2'000);
  EXPECT_EQ(audience_.Count("a second process uses the key of actuator r1/base"), 1);
  const std::string contested = "a second process uses the key of actuator base";
  EXPECT_THAT(robot_->Status().degraded, Contains(contested)) << "the session may be the wrong one";
  Pass(89'000);
  EXPECT_THAT(robot_->Status().degraded, Not(Contains(contested)));
}

TEST_F(RobotTest, AnAgentThatStartsAnewIsNoSecondHolder) {
  Start();
  Arm();
  sensor_heartbeats_ = false;
  Pass(200);
  robot_->OnSensorHello("base", std::make_shared<FakeSensor>(),
                        {.incarnation = "fedcba9876543210", .clock = clock_.Now()});
  // A heartbeat of the process that is gone was underway.
  SendSensorHeartbeat();
  Pass(1'500);
  sensor_heartbeats_ = true;
  ConnectSensor();
  Pass(3'000);
  EXPECT_EQ(audience_.Count("a second process"), 0);
}

TEST_F(RobotTest, HostsThatAreNotListedAreRefused) {
  Start();
  auto sensor = std::make_shared<FakeSensor>();
  auto actuator = std::make_shared<FakeActuator>();

  robot_->OnSensorHello("laptop", sensor, {.incarnation = kIncarnation});
  robot_->OnActuatorHello("laptop", actuator, {});

  EXPECT_THAT(sensor->closed, StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_THAT(actuator->closed, StatusIs(absl::StatusCode::kPermissionDenied));
}

TEST_F(RobotTest, MessagesOfAReplacedSessionAreIgnored) {
  Start();
  Arm();
  const auto first = sensor_;
  sensor_heartbeats_ = false;
  Pass(1'600);
  ConnectSensor();

  robot_->OnBatch(
      "base", first.get(),
      std::make_shared<const Batch>(Batch{.incarnation = kIncarnation,
                                          .lane = Lane::kControl,
                                          .first_sequence = 999,
                                          .observations = {{.what = SignalSeen{"SIGUSR1"}}}}));

  EXPECT_THAT(sensor_->closed, IsOk());
}

TEST_F(RobotTest, LateObservationsRaiseButDoNotLower) {
  Start();
  Arm();
  const int64_t ten_seconds_ago = Boottime() - 10 * kNanosPerSecond;
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder");

  SendBatch(Lane::kControl, {{.boottime_ns = ten_seconds_ago,
                              .what = GraphChange{.from_version = graph_version_,
                                                  .to_version = graph_version_ + 1,
                                                  .settled = true,
                                                  .delta = delta}}});

  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(RobotTest, LossesSpoilEvidenceUnlessTheWriterIsBestEffort) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  IntruderLeaves();
  Pass(4'000);

  SendBatch(Lane::kControl, {{.what = LossSeen{.count = 3, .cause = "gap", .tolerable = true}}});
  Pass(1'500);
  EXPECT_EQ(Level(), "DEFAULT");

  IntruderAppears();
  Obey();
  IntruderLeaves();
  Pass(4'000);
  SendBatch(Lane::kControl, {{.what = LossSeen{.count = 3, .cause = "outbox full"}}});
  Pass(1'500);
  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(RobotTest, FlappingSpendsTheBudgetOfSoftLowerings) {
  Start();
  Arm();
  for (int i = 0; i < 3; ++i) {
    IntruderAppears();
    Obey();
    IntruderLeaves();
    Pass(6'000);
    ASSERT_EQ(Level(), "DEFAULT") << i;
    Obey();
  }
  IntruderAppears();
  Obey();
  IntruderLeaves();

  Pass(60'000);
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_THAT(robot_->Status().degraded, Contains(HasSubstr("until an operator resumes")));
  EXPECT_THAT(robot_->ResumeRules("alice", "flapping camera replaced"), IsOk());
  Pass(1'000);
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(RobotTest, AcknowledgesOnlyWhatIsDurable) {
  Start();
  Arm();
  recorder_.held = true;
  const uint64_t before = sensor_->acknowledged[1];

  SendMessage(2);
  Pass(3'000);
  EXPECT_EQ(sensor_->acknowledged[1], before);

  recorder_.held = false;
  recorder_.Release();
  Drain();
  EXPECT_EQ(sensor_->acknowledged[1], before + 1);
}

TEST_F(RobotTest, AReconnectWhileTheStoreHangsAcknowledgesWhatIsDurableOnly) {
  Start();
  Arm();
  Pass(1'000);
  const uint64_t durable = sensor_->acknowledged[static_cast<int>(Lane::kControl)];
  recorder_.held = true;
  IntruderAppears();
  ASSERT_EQ(Level(), "ALERT");
  ASSERT_EQ(audience_.Count("unknown node"), 0) << "not durable";

  robot_->OnSensorGone("base", sensor_.get());
  ConnectSensor({{.incarnation = kIncarnation,
                  .lane = Lane::kControl,
                  .first_sequence = durable + 1,
                  .last_sequence = durable + 1}});
  EXPECT_EQ(sensor_->acknowledged[static_cast<int>(Lane::kControl)], durable)
      << "a crash now would lose the alert, and the sensor would have forgotten it";

  recorder_.held = false;
  recorder_.Release();
  Drain();
  EXPECT_EQ(sensor_->acknowledged[static_cast<int>(Lane::kControl)], durable + 1);
}

TEST_F(RobotTest, GrantsCreditForWhatWasJudged) {
  Start();
  Arm();
  const uint64_t first = sensor_->granted;
  EXPECT_EQ(first, Timing{}.credit_bytes);

  for (int i = 0; i < 6'000; ++i) SendMessage(2);

  EXPECT_GT(sensor_->granted, first);
  EXPECT_LE(sensor_->granted, first + 6'000 * 100);
}

TEST_F(RobotTest, RunsTheChainOfTheFailedProgram) {
  Start(kExecRules);
  actuator_ = std::make_shared<FakeActuator>();
  robot_->OnActuatorHello(
      "base", actuator_,
      {.levels = {"DEFAULT", "HALT"}, .programs = {"usb_alarm"}, .clock = clock_.Now()});
  ConnectSensor();
  SendSnapshot();
  IntruderAppears();
  Pass(50);

  EXPECT_EQ(Level(), "HALT") << "the last chain does not wait for the program";
  std::string run_id;
  for (const Command& command : actuator_->commands) {
    if (std::holds_alternative<RunProgram>(command.what)) run_id = command.id;
  }
  ASSERT_FALSE(run_id.empty());
  EXPECT_EQ(audience_.Count("usb_alarm failed"), 0);
  robot_->OnReceipt("base", actuator_.get(),
                    {.command_id = run_id, .stage = Receipt::Stage::kFailed, .exit_code = 3});
  Drain();
  EXPECT_EQ(audience_.Count("usb_alarm failed"), 1);
}

TEST_F(RobotTest, AProgramWaitsForNoTick) {
  Start(R"(
levels:
  DEFAULT;
  HALT;
rules Graph:
  R: nodecount(3, 100) ? exec("usb_alarm");
  never: false ? trigger(HALT);
)");
  actuator_ = std::make_shared<FakeActuator>();
  robot_->OnActuatorHello(
      "base", actuator_,
      {.levels = {"DEFAULT", "HALT"}, .programs = {"usb_alarm"}, .clock = clock_.Now()});
  ConnectSensor();
  SendSnapshot();
  const size_t before = actuator_->commands.size();

  IntruderAppears();

  ASSERT_EQ(actuator_->commands.size(), before + 1);
  EXPECT_TRUE(std::holds_alternative<RunProgram>(actuator_->commands.back().what));
}

TEST_F(RobotTest, ProgramsThatNobodyOffersAreToldWhenTheRobotIsArmed) {
  Start(kExecRules);
  EXPECT_EQ(audience_.Count("no actuator offers"), 0) << "nobody has said what it offers";
  actuator_ = std::make_shared<FakeActuator>();
  robot_->OnActuatorHello("base", actuator_,
                          {.levels = {"DEFAULT", "HALT"}, .clock = clock_.Now()});
  Drain();
  EXPECT_EQ(audience_.Count("no actuator offers, so they will fail: `usb_alarm`"), 1);
  EXPECT_THAT(robot_->Status().degraded,
              ::testing::Contains(::testing::HasSubstr("no actuator offers")));
  Pass(2'000);
  robot_->OnActuatorGone("base", actuator_.get());
  actuator_ = std::make_shared<FakeActuator>();
  robot_->OnActuatorHello("base", actuator_,
                          {.levels = {"DEFAULT", "HALT"}, .clock = clock_.Now()});
  Drain();
  EXPECT_EQ(audience_.Count("no actuator offers"), 1) << "once is enough";
}

TEST_F(RobotTest, AProgramThatNobodyOffersFailsAtOnce) {
  Start(kExecRules);
  ConnectSensor();
  SendSnapshot();

  IntruderAppears();

  EXPECT_EQ(audience_.Count("usb_alarm failed"), 1);
  EXPECT_EQ(audience_.Count("was not run"), 1);
}

TEST_F(RobotTest, AProgramWithoutResultFailsInTime) {
  Start(kExecRules);
  actuator_ = std::make_shared<FakeActuator>();
  robot_->OnActuatorHello(
      "base", actuator_,
      {.levels = {"DEFAULT", "HALT"}, .programs = {"usb_alarm"}, .clock = clock_.Now()});
  ConnectSensor();
  SendSnapshot();
  IntruderAppears();

  Pass(11'000);

  EXPECT_EQ(audience_.Count("usb_alarm failed"), 1);
}

TEST_F(RobotTest, AnotherBundleKeepsLevelAndVariables) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  std::string rules = kPaperRules;
  rules += "  extra: Uptime < 0 ? alert(\"never\");\n";
  const std::vector<lang::SourceFile> files = {{.path = "b.rul", .text = rules}};
  auto compiled = lang::Compile(files);
  ASSERT_TRUE(compiled.rules) << lang::RenderText(files, compiled.diagnostics);

  EXPECT_THAT(robot_->SwapPolicy({.program = *engine::CompiledPolicy::Create(*compiled.rules),
                                  .bundle_id = "sha256:1"}),
              IsOk());

  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(robot_->Status().bundle_version, "sha256:1");
  Pass(10'000);
  EXPECT_EQ(Level(), "ALERT") << "`intruder` is still true";
}

TEST_F(RobotTest, ARobotThatAnotherServerOwnsRetiresAndLowersNothing) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  const size_t commands = actuator_->commands.size();
  const size_t decisions = recorder_.decisions.size();
  recorder_.fail = absl::AbortedError("tenure 1 is over");
  absl::Status answer;
  robot_->DeEscalate({.operator_name = "alice",
                      .to = "DEFAULT",
                      .reason = "calm",
                      .expected_level = "ALERT",
                      .expected_decision_id = robot_->Status().decision_id,
                      .accept_blind = true},
                     [&](const LevelAnswer& given) { answer = given.status; });
  Drain();

  EXPECT_THAT(answer, StatusIs(absl::StatusCode::kAborted, HasSubstr("tenure 1 is over")));
  EXPECT_THAT(fenced_, ElementsAre("r1"));
  EXPECT_THAT(actuator_->closed, StatusIs(absl::StatusCode::kAborted));
  EXPECT_THAT(sensor_->closed, StatusIs(absl::StatusCode::kAborted));
  const size_t leases = actuator_->leases.size();
  recorder_.fail = absl::OkStatus();
  Pass(20'000);
  EXPECT_EQ(actuator_->commands.size(), commands);
  EXPECT_EQ(actuator_->leases.size(), leases) << "they end";
  EXPECT_EQ(recorder_.decisions.size(), decisions);
  EXPECT_TRUE(robot_->gone());
}

TEST_F(RobotTest, ATermThatAFormerOwnerAsksForRetiresItsRobotToo) {
  Start();
  recorder_.term_fail = absl::AbortedError("tenure 1 is over");
  ConnectActuator({.decision_id = {9, 1}, .effective_level = "DEFAULT", .highest_term = 9});
  Drain();
  EXPECT_THAT(fenced_, ElementsAre("r1"));
  EXPECT_THAT(actuator_->closed, StatusIs(absl::StatusCode::kAborted));
  EXPECT_TRUE(actuator_->leases.empty());
}

}  // namespace
}  // namespace rips::pipeline
