// The paper's story, and what must not change it: RIPS paper, "Experimental Validation".
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::EndsWith;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

LevelOrder Lower(const std::string& to, const RobotStatus& seen) {
  return {.operator_name = "alice",
          .to = to,
          .reason = "checked on site",
          .expected_level = seen.decided_level,
          .expected_decision_id = seen.decision_id,
          .request_id = "q1"};
}

TEST_F(RobotTest, StartsWithARecordedDecisionAtTheStartLevel) {
  Start();

  robot_->OnTime();
  Drain();

  ASSERT_EQ(recorder_.decisions.size(), 1u);
  EXPECT_EQ(recorder_.decisions[0].to, "DEFAULT");
  EXPECT_EQ(recorder_.decisions[0].decision_id, (DecisionId{1, 1}));
  EXPECT_EQ(recorder_.decisions[0].reason, "first start");
  EXPECT_EQ(Stage(), "requested");
}

TEST_F(RobotTest, TellsThePapersStory) {
  Start();
  Arm();
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(Stage(), "verified");

  IntruderAppears();
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(actuator_->level()->to, "ALERT");
  Obey();
  Pass(200);

  SendMessage(9);
  EXPECT_EQ(Level(), "ALERT") << "the intruder does not publish: the graph says so";
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder", "/cmd_vel");
  SendDelta(std::move(delta));
  SendMessage(9);
  EXPECT_EQ(Level(), "COMPROMISED");
  EXPECT_EQ(actuator_->level()->to, "COMPROMISED");
  Obey();

  IntruderLeaves();
  Pass(20'000);
  EXPECT_EQ(Level(), "COMPROMISED") << "a hard level needs a person";

  LevelAnswer answer;
  robot_->DeEscalate(Lower("ALERT", robot_->Status()), [&](const LevelAnswer& a) { answer = a; });
  Drain();
  EXPECT_THAT(answer.status, IsOk());
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(actuator_->level()->based_on, (DecisionId{1, 3}));
  Obey();

  Pass(4'500);
  EXPECT_EQ(Level(), "ALERT") << "soft_hold has not passed";
  Pass(1'500);
  EXPECT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(recorder_.decisions.back().cause, "rule quiet");
}

TEST_F(RobotTest, ADecisionThatWasOvertakenIsRecordedAsSuperseded) {
  Start();
  Arm();
  IntruderAppears();
  const DecisionId overtaken = robot_->Status().decision_id;
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/intruder", "/cmd_vel");
  SendDelta(std::move(delta));

  SendMessage(9);
  Obey();

  EXPECT_THAT(
      recorder_.stages,
      Contains(store::StageUpdate{.decision_id = overtaken, .stage = "superseded", .detail = ""}));
  EXPECT_EQ(recorder_.stages.back().stage, "verified");
}

TEST_F(RobotTest, CommandsARaiseBeforeItIsRecorded) {
  Start();
  Arm();
  recorder_.held = true;

  IntruderAppears();

  EXPECT_EQ(actuator_->level()->to, "ALERT");
  EXPECT_EQ(recorder_.decisions.back().to, "DEFAULT");
  EXPECT_EQ(audience_.Count("unknown node"), 0) << "nobody is told before it is durable";
  recorder_.held = false;
  recorder_.Release();
  Drain();
  EXPECT_EQ(recorder_.decisions.back().to, "ALERT");
  EXPECT_EQ(audience_.Count("unknown node"), 1);
}

TEST_F(RobotTest, ASoftLevelDoesNotSinkInTheEventThatRaisedIt) {
  Start(R"(
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
rules External:
  up: signal("SIGUSR1") ? trigger(ALERT);
  down: CurrLevel == ALERT ? trigger(DEFAULT);
  last: false ? trigger(COMPROMISED), trigger(HALT);
)");
  Arm();
  Pass(10'000);
  ASSERT_THAT(robot_->Status().degraded, IsEmpty()) << "else nothing could sink anyhow";

  SendBatch(Lane::kControl, {{.what = SignalSeen{.name = "SIGUSR1"}}});
  EXPECT_EQ(Level(), "ALERT");
  Pass(1'000);
  EXPECT_EQ(Level(), "ALERT") << "not verified";
  Obey();
  Pass(4'500);
  EXPECT_EQ(Level(), "ALERT") << "soft_hold has not passed";
  Pass(1'500);
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(RobotTest, EvidenceStartsAnewWithARaiseOfTheSameBatch) {
  Start(R"(
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
rules External:
  up: signal("SIGUSR1") ? trigger(ALERT);
  down: signal("SIGUSR2") ? trigger(DEFAULT);
  last: false ? trigger(COMPROMISED), trigger(HALT);
)");
  Arm();
  Pass(10'000);
  ASSERT_THAT(robot_->Status().degraded, IsEmpty()) << "else nothing could sink anyhow";
  // Two events; nothing else runs between them.
  SendBatch(Lane::kControl,
            {{.what = SignalSeen{.name = "SIGUSR1"}}, {.what = SignalSeen{.name = "SIGUSR2"}}});
  EXPECT_EQ(Level(), "ALERT");
  Obey();
  Pass(6'000);
  SendBatch(Lane::kControl, {{.what = SignalSeen{.name = "SIGUSR2"}}});
  EXPECT_EQ(Level(), "DEFAULT") << "verified, and soft_hold has passed";
}

TEST_F(RobotTest, ARestoredHistoryLowersNothing) {
  struct Case {
    const char* what;
    DecisionId held;
    const char* held_level;
    const char* expected;
  };
  const Case cases[] = {
      {"a known decision under another level", {6, 9}, "HALT", "HALT"},
      {"the newest decision under another level", {6, 10}, "HALT", "HALT"},
      {"the newest decision under a lower level", {6, 10}, "ALERT", "COMPROMISED"},
      {"a known decision under its own level", {6, 9}, "ALERT", "COMPROMISED"},
      {"an unknown decision", {6, 11}, "HALT", "HALT"},
  };
  for (const Case& each : cases) {
    SCOPED_TRACE(each.what);
    recorder_.decisions = {{.decision_id = {6, 9}, .to = "ALERT"},
                           {.decision_id = {6, 10}, .to = "COMPROMISED"}};
    audience_.alerts.clear();
    Start(kPaperRules, {.level = "COMPROMISED", .decision_id = {6, 10}}, 7);
    ConnectSensor();
    ConnectActuator({.decision_id = each.held,
                     .decided_level = each.held_level,
                     .effective_level = each.held_level,
                     .highest_term = 6});
    EXPECT_EQ(Level(), each.expected);
    const bool contradicts = std::string(each.what) != "a known decision under its own level";
    EXPECT_EQ(audience_.Count("the more restrictive level is adopted"), contradicts ? 1 : 0);
    EXPECT_NE(Stage(), "verified");
    EXPECT_EQ(robot_->Status().decision_id > each.held, contradicts || each.held.epoch == 9);
  }
}

TEST_F(RobotTest, ATermThatAnActuatorKnowsBeforeItMetUsIsNotOurs) {
  Start(kPaperRules, {.level = "DEFAULT", .decision_id = {6, 10}}, 7);
  recorder_.decisions = {{.decision_id = {6, 10}, .to = "DEFAULT"}};
  ConnectActuator({.decision_id = {6, 10},
                   .decided_level = "DEFAULT",
                   .effective_level = "DEFAULT",
                   .highest_term = 7});
  Pass(100);
  EXPECT_EQ(audience_.Count("has obeyed term 7, our term is 7"), 1);
  EXPECT_EQ(actuator_->leases.back().term, 8u);

  actuator_heartbeats_ = false;
  Pass(3'000);
  ConnectActuator({.decision_id = {6, 10},
                   .decided_level = "DEFAULT",
                   .effective_level = "DEFAULT",
                   .highest_term = 8});
  EXPECT_EQ(actuator_->leases.back().term, 8u) << "that is the term it has from us";
}

TEST_F(RobotTest, CommandsALoweringOnlyWhenItIsDurable) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  recorder_.held = true;
  LevelAnswer answer{.status = absl::UnknownError("not answered")};

  robot_->DeEscalate(Lower("DEFAULT", robot_->Status()), [&](const LevelAnswer& a) { answer = a; });
  Drain();

  EXPECT_EQ(actuator_->level()->to, "ALERT");
  Pass(600);
  EXPECT_EQ(actuator_->leases.back().level, "ALERT") << "a lease does not announce it either";
  EXPECT_THAT(answer.status, StatusIs(absl::StatusCode::kUnknown));
  recorder_.held = false;
  recorder_.Release();
  Drain();
  EXPECT_EQ(actuator_->level()->to, "DEFAULT");
  EXPECT_THAT(answer.status, IsOk());
}

// COMPROMISED is lowered to DEFAULT and raised to ALERT while the disk hangs.
class RaiseAfterLoweringTest : public RobotTest {
 protected:
  void LowerAndRaise() {
    Start();
    Arm();
    Raise("COMPROMISED");
    Obey();
    recorder_.held = true;
    robot_->DeEscalate(Lower("DEFAULT", robot_->Status()),
                       [this](const LevelAnswer& a) { lowered_ = a.status; });
    Raise("ALERT");
    ASSERT_EQ(Level(), "ALERT");
    Pass(600);
    EXPECT_EQ(actuator_->level()->to, "COMPROMISED");
    EXPECT_EQ(actuator_->leases.back().level, "COMPROMISED");
  }
  void Raise(const std::string& level) {
    robot_->Raise({.operator_name = "alice", .to = level, .reason = "drill"},
                  [](const LevelAnswer&) {});
    Drain();
  }
  void DiskGoesOn(const absl::Status& fail) {
    recorder_.fail = fail;
    recorder_.held = false;
    recorder_.Release();
    Drain();
  }

  absl::Status lowered_ = absl::UnknownError("not answered");
};

TEST_F(RaiseAfterLoweringTest, LowersNothingBeforeBothAreDurable) {
  LowerAndRaise();
  DiskGoesOn(absl::OkStatus());
  EXPECT_THAT(lowered_, IsOk());
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(actuator_->level()->to, "ALERT");
}

TEST_F(RaiseAfterLoweringTest, LowersNothingIfTheLoweringCannotBeRecorded) {
  LowerAndRaise();
  DiskGoesOn(absl::UnavailableError("disk full"));
  EXPECT_THAT(lowered_, StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_EQ(Level(), "COMPROMISED");
  for (const Command& command : actuator_->commands) {
    const auto* set = std::get_if<SetLevel>(&command.what);
    ASSERT_NE(set, nullptr);
    EXPECT_NE(set->to, "ALERT");
  }
}

TEST_F(RobotTest, TakesALoweringBackThatCannotBeRecorded) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  recorder_.held = true;
  LevelAnswer answer;
  robot_->DeEscalate(Lower("DEFAULT", robot_->Status()), [&](const LevelAnswer& a) { answer = a; });

  recorder_.fail = absl::UnavailableError("disk full");
  recorder_.held = false;
  recorder_.Release();
  Drain();

  EXPECT_EQ(Level(), "ALERT");
  EXPECT_THAT(answer.status,
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("disk full")));
  for (const Command& command : actuator_->commands) {
    const auto* set = std::get_if<SetLevel>(&command.what);
    ASSERT_NE(set, nullptr);
    EXPECT_FALSE(set->to == "DEFAULT" && set->decision_id > (DecisionId{1, 1}));
  }
  recorder_.fail = absl::OkStatus();
  Pass(2'000);
  EXPECT_EQ(recorder_.decisions.back().to, "ALERT") << "records are kept and written later";
  EXPECT_EQ(audience_.Count("taken back"), 1);
}

// A slow store: what a rule saw must hold until its lowering leaves.
TEST_F(RobotTest, ALoweringByARuleIsTakenBackIfItsSensorLeavesWhileItIsRecorded) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  Pass(6'000);
  recorder_.held = true;
  IntruderLeaves();
  Pass(6'000);
  ASSERT_EQ(Level(), "DEFAULT");
  EXPECT_EQ(Stage(), "requested") << "that ALERT is verified says nothing of it";
  const DecisionId lowering = robot_->Status().decision_id;
  actuator_->commands.clear();

  robot_->OnSensorGone("base", sensor_.get());
  recorder_.held = false;
  recorder_.Release();
  Drain();

  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(audience_.Count("a lowering was taken back: while it was recorded, sensor base is not "
                            "connected"),
            1);
  for (const Command& command : actuator_->commands) {
    const auto* set = std::get_if<SetLevel>(&command.what);
    ASSERT_NE(set, nullptr);
    EXPECT_EQ(set->to, "ALERT");
  }
  EXPECT_EQ(robot_->Status().decision_id.term, lowering.term) << "the store gave no other";
}

TEST_F(RobotTest, RefusesToLowerWhileTheStoreFails) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  recorder_.fail = absl::UnavailableError("disk full");
  SendMessage(2);
  Pass(1'500);

  LevelAnswer answer;
  LevelOrder order = Lower("DEFAULT", robot_->Status());
  // That it is also blind then is not what to mend first: the same answer with and without.
  for (const bool accept_blind : {false, true}) {
    order.accept_blind = accept_blind;
    robot_->DeEscalate(order, [&](const LevelAnswer& a) { answer = a; });
    Drain();
    EXPECT_THAT(answer.status, StatusIs(absl::StatusCode::kFailedPrecondition,
                                        HasSubstr("the server's store cannot be written")));
  }
  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(RobotTest, RestartKeepsLevelAndVariablesAndEntersNothingTwice) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  Pass(1'100);
  store::RobotRecord record{.level = "ALERT",
                            .decision_id = recorder_.decisions.back().decision_id,
                            .variables = recorder_.variables,
                            .high_water = recorder_.high_water};

  Start(kPaperRules, record, /*term=*/2);
  ConnectActuator(
      {.decision_id = record.decision_id, .decided_level = "ALERT", .effective_level = "ALERT"});
  verified_ = true;
  Pass(200);

  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(Stage(), "verified");
  EXPECT_EQ(actuator_->level(), nullptr) << "it holds the newest decision already";
  EXPECT_EQ(actuator_->leases.back().term, 2u);
  ConnectSensor({{.incarnation = kIncarnation,
                  .lane = Lane::kControl,
                  .first_sequence = 1,
                  .last_sequence = 2}});
  EXPECT_EQ(sensor_->acknowledged[0], 2u);
  EXPECT_TRUE(sensor_->setup.want_snapshot);
  Pass(30'000);
  EXPECT_EQ(Level(), "ALERT") << "the graph has not been seen again";
}

TEST_F(RobotTest, AdoptsAMoreRestrictiveLevelThatItDoesNotKnow) {
  Start();

  ConnectActuator({.decision_id = {1, 7},
                   .decided_level = "COMPROMISED",
                   .effective_level = "COMPROMISED",
                   .highest_term = 1});

  EXPECT_EQ(Level(), "COMPROMISED");
  EXPECT_GT(robot_->Status().decision_id, (DecisionId{1, 7}));
  EXPECT_EQ(audience_.Count("does not know"), 1);
}

TEST_F(RobotTest, AnUnknownLowerLevelDoesNotLower) {
  Start(kPaperRules, {.level = "COMPROMISED", .decision_id = {1, 5}}, 2);

  ConnectActuator(
      {.decision_id = {1, 9}, .decided_level = "DEFAULT", .effective_level = "DEFAULT"});

  EXPECT_EQ(Level(), "COMPROMISED");
  EXPECT_EQ(actuator_->level()->to, "COMPROMISED");
}

TEST_F(RobotTest, GoesAboveATermThatTheActuatorHasSeen) {
  Start();

  ConnectActuator({.effective_level = "DEFAULT", .highest_term = 41});

  EXPECT_EQ(actuator_->leases.back().term, 42u);
  EXPECT_EQ(audience_.Count("our term is"), 1);
}

TEST_F(RobotTest, RefusesAnImpossibleTerm) {
  Start();

  ConnectActuator({.effective_level = "DEFAULT", .highest_term = UINT64_MAX});

  EXPECT_THAT(actuator_->closed, StatusIs(absl::StatusCode::kFailedPrecondition));
}

TEST_F(RobotTest, DoesNotArmAnActuatorWithOtherLevels) {
  Start();
  actuator_ = std::make_shared<FakeActuator>();

  robot_->OnActuatorHello("base", actuator_, {.levels = {"DEFAULT", "HALT"}});
  Drain();

  EXPECT_THAT(actuator_->closed, StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_THAT(actuator_->commands, IsEmpty());
  EXPECT_EQ(audience_.Count("not armed"), 1);
}

TEST_F(RobotTest, AManagerThatDoesNothingEndsAsFailedAndTheDecisionStands) {
  Start();
  Arm();
  IntruderAppears();

  Obey(Receipt::Stage::kFailed, "/safety=DEFAULT, camera active");

  EXPECT_EQ(Stage(), "failed");
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_EQ(audience_.Count("was not reached"), 1);
  const size_t before = actuator_->commands.size();
  Pass(6'000);
  EXPECT_EQ(actuator_->commands.size(), before + 1) << "it is tried again";
  EXPECT_EQ(audience_.Count("was not reached"), 1) << "and told once";
  EXPECT_EQ(audience_.Count("is reached now"), 0);
  Obey();
  EXPECT_EQ(audience_.Count("level ALERT is reached now, and verified"), 1);
}

TEST_F(RobotTest, ResendsACommandUntilItIsAcknowledged) {
  Start();
  Arm();
  IntruderAppears();
  const std::string id = actuator_->commands.back().id;
  const size_t before = actuator_->commands.size();

  Pass(2'100);

  ASSERT_EQ(actuator_->commands.size(), before + 1);
  EXPECT_EQ(actuator_->commands.back().id, id) << "the same command, so it is executed once";
}

TEST_F(RobotTest, ReportsDrift) {
  Start();
  Arm();

  verified_ = false;
  Pass(100);

  EXPECT_EQ(audience_.Count("no longer is at"), 1);
  EXPECT_EQ(Stage(), "acknowledged");
}

constexpr char kDriftRules[] = R"(
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
rules External:
  left: agent("actuator", "drift") ? alert("left", "low");
  a: false ? trigger(ALERT);
  c: false ? trigger(COMPROMISED);
  h: false ? trigger(HALT);
)";

TEST_F(RobotTest, EachNewDriftIsAnEventAlsoWhenItIsOverBeforeTheHeartbeat) {
  Start(kDriftRules);
  Arm();
  drifts_ = 1;  // found left and put back since the last heartbeat
  Pass(100);
  EXPECT_EQ(audience_.Count("no longer is at"), 1);
  EXPECT_EQ(audience_.Count("left"), 1);
  Pass(1'000);
  EXPECT_EQ(audience_.Count("left"), 1) << "told once";

  drifts_ = 4;
  verified_ = false;
  Pass(50);
  EXPECT_EQ(audience_.Count("3 times by now"), 1);
  EXPECT_EQ(audience_.Count("left"), 4);

  drifts_ = 2;  // of an actuator that started anew
  Pass(50);
  EXPECT_EQ(audience_.Count("left"), 6);
}

TEST_F(RobotTest, DriftsBeforeTheFirstHeartbeatSayNothingOfNow) {
  Start(kDriftRules);
  drifts_ = 40;
  Arm();
  Pass(1'000);
  EXPECT_EQ(audience_.Count("left"), 0);
}

TEST_F(RobotTest, WhatIsDegradedIsStatusAndAlertsWhenItBeginsAndEnds) {
  Start();
  Arm();
  degraded_ = {"/safety=ALERT is held without the mode manager: it left 2 times"};
  Pass(1'000);
  EXPECT_EQ(audience_.Count("actuator base: /safety=ALERT is held without"), 1);
  EXPECT_THAT(robot_->Status().degraded, ::testing::Contains("actuator base: " + degraded_[0]));
  degraded_ = {"/safety=ALERT is held without the mode manager: it left 3 times", "/camera is off"};
  Pass(1'000);
  EXPECT_EQ(audience_.Count("actuator base: /safety=ALERT is held without"), 1) << "the same";
  EXPECT_EQ(audience_.Count("actuator base: /camera is off"), 1);
  degraded_.clear();
  Pass(1'000);
  EXPECT_EQ(audience_.Count("actuator base is no longer degraded"), 1);
  EXPECT_THAT(robot_->Status().degraded,
              ::testing::Not(::testing::Contains(::testing::HasSubstr("actuator base:"))));
}

TEST_F(RobotTest, AFailSafeThatAnActuatorTookIsToldOnce) {
  Start();
  ConnectActuator({.effective_level = "COMPROMISED"});
  Obey();
  floor_ = "lease expired";
  effective_ = "COMPROMISED";
  Pass(3'000);
  EXPECT_EQ(audience_.Count("actuator base holds r1 at COMPROMISED by itself: lease expired"), 1);

  floor_.clear();
  effective_ = "DEFAULT";
  Pass(3'000);
  EXPECT_EQ(audience_.Count("actuator base no longer holds r1 at a level of its own"), 1);
}

TEST_F(RobotTest, AFloorThatLiftsIsNotDrift) {
  Start();
  ConnectActuator({.effective_level = "ALERT"});
  Obey();
  floor_ = "state lost";
  effective_ = "ALERT";
  Pass(100);
  EXPECT_EQ(Stage(), "verified") << "a raise is verified at its level or above";

  floor_.clear();
  verified_ = false;
  Pass(100);
  EXPECT_EQ(Stage(), "acknowledged");
  effective_ = "DEFAULT";
  verified_ = true;
  Pass(100);

  EXPECT_EQ(Stage(), "verified");
  EXPECT_EQ(audience_.Count("no longer is at"), 0);
}

TEST_F(RobotTest, AnActuatorThatComesBackAtAFloorIsNotDrift) {
  Start();
  Arm();
  robot_->OnActuatorGone("base", actuator_.get());
  Drain();
  actuator_heartbeats_ = false;
  Pass(100);
  ConnectActuator({.effective_level = "ALERT"});
  actuator_heartbeats_ = true;
  effective_ = "ALERT";
  floor_ = "lease expired";
  Pass(1'000);
  EXPECT_EQ(audience_.Count("holds r1 at ALERT by itself: lease expired"), 1);
  EXPECT_EQ(audience_.Count("no longer is at"), 0) << "its cable was cut";
}

TEST_F(RobotTest, OperatorMustHaveSeenTheNewestDecision) {
  Start();
  Arm();
  const RobotStatus seen = robot_->Status();
  IntruderAppears();
  Obey();

  LevelAnswer answer;
  robot_->DeEscalate(Lower("DEFAULT", seen), [&](const LevelAnswer& a) { answer = a; });
  Drain();

  EXPECT_THAT(answer.status, StatusIs(absl::StatusCode::kFailedPrecondition));
  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(RobotTest, OperatorMustGiveAReason) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  LevelOrder order = Lower("DEFAULT", robot_->Status());

  for (const size_t bytes : {size_t{0}, size_t{1'001}}) {
    order.reason = std::string(bytes, 'x');
    LevelAnswer answer;
    robot_->DeEscalate(order, [&](const LevelAnswer& a) { answer = a; });
    EXPECT_THAT(answer.status, StatusIs(absl::StatusCode::kInvalidArgument)) << bytes;
  }
  EXPECT_EQ(Level(), "ALERT");
}

TEST_F(RobotTest, OperatorIsRefusedWhileBlindUnlessAccepted) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  robot_->OnSensorGone("base", sensor_.get());
  LevelOrder order = Lower("DEFAULT", robot_->Status());

  LevelAnswer refused;
  robot_->DeEscalate(order, [&](const LevelAnswer& a) { refused = a; });
  Drain();
  EXPECT_THAT(refused.status, StatusIs(absl::StatusCode::kFailedPrecondition,
                                       HasSubstr("sensor base is not connected")));

  LevelAnswer accepted;
  order.accept_blind = true;
  robot_->DeEscalate(order, [&](const LevelAnswer& a) { accepted = a; });
  Drain();
  EXPECT_THAT(accepted.status, IsOk());
  EXPECT_EQ(Level(), "DEFAULT");
}

TEST_F(RobotTest, ARepeatedRequestGetsItsFirstAnswer) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  const LevelOrder order = Lower("DEFAULT", robot_->Status());
  LevelAnswer first;
  LevelAnswer second;

  robot_->DeEscalate(order, [&](const LevelAnswer& a) { first = a; });
  Drain();
  const size_t decisions = recorder_.decisions.size();
  robot_->DeEscalate(order, [&](const LevelAnswer& a) { second = a; });
  Drain();

  EXPECT_THAT(second.status, IsOk());
  EXPECT_EQ(first.decision_id, second.decision_id);
  EXPECT_EQ(recorder_.decisions.size(), decisions);
}

TEST_F(RobotTest, ARepeatedRequestIsNotAnsweredBeforeTheFirstIsDurable) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  recorder_.held = true;
  const LevelOrder order = Lower("DEFAULT", robot_->Status());
  LevelAnswer first{.status = absl::UnknownError("not answered")};
  LevelAnswer second;

  robot_->DeEscalate(order, [&](const LevelAnswer& a) { first = a; });
  robot_->DeEscalate(order, [&](const LevelAnswer& a) { second = a; });

  EXPECT_THAT(first.status, StatusIs(absl::StatusCode::kUnknown));
  EXPECT_THAT(second.status, StatusIs(absl::StatusCode::kUnavailable));
  recorder_.Release();
  Drain();
  EXPECT_THAT(first.status, IsOk());
}

TEST_F(RobotTest, DryRunSaysWhatWouldRaiseItAgainAndChangesNothing) {
  Start();
  Arm();
  IntruderAppears();
  Obey();
  LevelOrder order = Lower("DEFAULT", robot_->Status());
  order.dry_run = true;

  LevelAnswer answer;
  robot_->DeEscalate(order, [&](const LevelAnswer& a) { answer = a; });
  Drain();

  EXPECT_THAT(answer.status, IsOk());
  EXPECT_THAT(answer.would_raise_again, Contains("unknown_node"));
  EXPECT_EQ(Level(), "ALERT");
}

constexpr char kSecondPublisher[] = R"(
levels:
  DEFAULT;
  ALERT soft;
  COMPROMISED;
  HALT;
rules Msg:
  second: topicin("/cmd_vel") && !publishercount(0, 1) ? alert("two drive") => trigger(HALT);
rules External:
  others: false ? trigger(ALERT), trigger(COMPROMISED);
)";

TEST_F(RobotTest, AnAlertForASecondNodeOfTheSameNameSaysWhichOneWrote) {
  Start(kSecondPublisher);
  Arm();
  ros2::GraphDelta delta;
  AddNode(&delta, 9, "/navigator", "/cmd_vel");
  delta.upsert_participants[0].host = "laptop";
  SendDelta(std::move(delta));

  SendMessage(9);

  ASSERT_EQ(audience_.Count("two drive"), 1);
  EXPECT_THAT(audience_.alerts,
              Contains(Field(&store::AlertRecord::event,
                             absl::StrCat("message on /cmd_vel from /navigator of participant ",
                                          ToString(Participant(9)),
                                          " on laptop; other nodes of this name: participant ",
                                          ToString(Participant(2))))));
}

TEST_F(RobotTest, AnAlertNamesAFewOfManyNodesOfOneName) {
  Start(kSecondPublisher);
  Arm();
  ros2::GraphDelta delta;
  for (uint8_t n = 10; n < 100; ++n) AddNode(&delta, n, "/navigator", "/cmd_vel");
  SendDelta(std::move(delta));

  SendMessage(2);

  const std::string few = absl::StrCat("from /navigator of participant ", ToString(Participant(2)),
                                       "; other nodes of this name: participant ");
  const std::string last = absl::StrCat(ToString(Participant(13)), ", and more");
  EXPECT_THAT(audience_.alerts,
              Contains(Field(&store::AlertRecord::event, AllOf(HasSubstr(few), EndsWith(last)))));
}

}  // namespace
}  // namespace rips::pipeline
