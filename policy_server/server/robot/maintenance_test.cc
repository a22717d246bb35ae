// A robot whose agents may be away, as its alerts, its level and its store say.
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "services/base/status_matchers.h"

namespace rips::pipeline {
namespace {

using ::testing::AllOf;
using ::testing::Contains;
using ::testing::Each;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr int64_t kMinute = 60 * kNanosPerSecond;
constexpr char kCarol[] = "carol (spiffe://td/operator/operator/carol serial 0c)";
constexpr char kMark[] = "in maintenance until 2026-01-01 00:20";

class MaintenanceTest : public RobotTest {
 protected:
  absl::Status Begin(int64_t minutes = 20) {
    const absl::Status status = robot_->SetMaintenance(
        {.operator_name = kCarol, .reason = "reboot", .for_ns = minutes * kMinute});
    Drain();
    return status;
  }
  absl::Status End() {
    const absl::Status status =
        robot_->SetMaintenance({.operator_name = "dave", .reason = "it is back"});
    Drain();
    return status;
  }
  void LoseSensor() {
    robot_->OnSensorGone("base", sensor_.get());
    sensor_ = nullptr;
    Pass(6'000);
  }
  void LoseActuator() {
    robot_->OnActuatorGone("base", actuator_.get());
    actuator_ = nullptr;
    Pass(6'000);
  }
  void RogueMessage() {
    ros2::GraphDelta delta;
    AddNode(&delta, 9, "/intruder", "/cmd_vel");
    SendDelta(std::move(delta));
    SendMessage(9);
  }
  // At once: the time between is of no interest.
  void Wait(int64_t ns) {
    clock_.Advance(ns);
    robot_->OnTime();
    Drain();
  }
  // The server ends, and starts again on what the store has.
  void Restart() {
    const store::RobotRecord record{.level = Level(),
                                    .decision_id = robot_->Status().decision_id,
                                    .maintenance = recorder_.maintenance};
    robot_.reset();
    sensor_ = nullptr;
    actuator_ = nullptr;
    audience_.alerts.clear();
    Start(kPaperRules, record, 2);
  }
  static auto Alert(const std::string& severity, const std::string& text) {
    return Contains(AllOf(Field(&store::AlertRecord::severity, severity),
                          Field(&store::AlertRecord::text, HasSubstr(text))));
  }
};

TEST_F(MaintenanceTest, OneOperatorChangesItSoOftenThatEachChangeHasItsAlert) {
  Start();
  for (int64_t i = 0; i < 6; ++i) ASSERT_THAT(Begin(20 + i), IsOk()) << i;
  EXPECT_THAT(Begin(24 * 60),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("too often")));
  EXPECT_THAT(End(), IsOk()) << "another operator";
  for (int minutes = 20; minutes < 26; ++minutes) {
    EXPECT_THAT(audience_.alerts, Alert("medium", absl::StrCat("until 2026-01-01 00:", minutes)));
  }
  Wait(10 * kNanosPerSecond);
  EXPECT_THAT(Begin(), IsOk());
  EXPECT_THAT(Begin(), StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("10 s")));
}

TEST_F(MaintenanceTest, AMarkHasTheStartOfALongReason) {
  Start();
  ASSERT_THAT(robot_->SetMaintenance(
                  {.operator_name = kCarol, .reason = std::string(1'000, 'x'), .for_ns = kMinute}),
              IsOk());
  Drain();
  LoseSensor();
  ASSERT_FALSE(audience_.alerts.empty());
  for (const store::AlertRecord& each : audience_.alerts) EXPECT_LT(each.maintenance.size(), 250u);
}

TEST_F(MaintenanceTest, AlertsOfAbsenceAreInfoAndSayWhy) {
  Start();
  Arm();
  ASSERT_THAT(Begin(), IsOk());
  EXPECT_THAT(audience_.alerts,
              Alert("medium",
                    "puts r1 in maintenance until 2026-01-01 00:20:00 UTC; alerts of "
                    "absent agents have the severity info until then: reboot"));
  LoseSensor();
  LoseActuator();
  for (const char* text : {"sensor base is lost", "actuator base is lost"}) {
    EXPECT_THAT(audience_.alerts, Alert("info", text));
    EXPECT_THAT(audience_.alerts, Not(Alert("high", text)));
    EXPECT_THAT(audience_.alerts, Contains(Field(&store::AlertRecord::text,
                                                 AllOf(HasSubstr(text), HasSubstr(kMark),
                                                       HasSubstr("(asked by carol: reboot)")))));
  }
  EXPECT_EQ(robot_->Status().maintenance->by, kCarol);
  EXPECT_EQ(audience_.statuses.back().maintenance, robot_->Status().maintenance);
}

TEST_F(MaintenanceTest, WithoutItTheyAreHighAndCarryNoMark) {
  Start();
  Arm();
  LoseSensor();
  LoseActuator();
  EXPECT_THAT(audience_.alerts, Alert("high", "sensor base is lost"));
  EXPECT_THAT(audience_.alerts, Alert("high", "actuator base is lost"));
  EXPECT_THAT(audience_.alerts, Each(Field(&store::AlertRecord::maintenance, IsEmpty())));
  EXPECT_EQ(robot_->Status().maintenance, std::nullopt);
}

TEST_F(MaintenanceTest, RulesDecideAsBeforeAndTheirAlertsCarryTheMark) {
  Start();
  Arm();
  ASSERT_THAT(Begin(), IsOk());
  audience_.alerts.clear();
  RogueMessage();
  EXPECT_EQ(Level(), "COMPROMISED");
  ASSERT_THAT(audience_.alerts, Alert("critical", "rogue cmd_vel"));
  EXPECT_THAT(audience_.alerts,
              Each(Field(&store::AlertRecord::maintenance,
                         AllOf(HasSubstr(kMark), HasSubstr("(asked by carol: reboot)")))));
  EXPECT_NE(actuator_->level(), nullptr);
  EXPECT_EQ(actuator_->level()->to, "COMPROMISED");
}

// The level that a rule or an operator raised is not in force: that is not only absence.
TEST_F(MaintenanceTest, ARaiseThatDoesNotReachAnAbsentActuatorIsCriticalAllTheSame) {
  Start();
  Arm();
  ASSERT_THAT(Begin(), IsOk());
  LoseActuator();
  RogueMessage();
  Pass(6'000);
  EXPECT_THAT(audience_.alerts,
              Alert("critical", "level COMPROMISED is not in force on actuator base"));
}

TEST_F(MaintenanceTest, EvidenceIsIncompleteAsWithoutIt) {
  Start();
  Arm();
  ASSERT_THAT(Begin(), IsOk());
  LoseSensor();
  EXPECT_THAT(robot_->Status().degraded, Not(IsEmpty()));
  LevelAnswer answer;
  robot_->Raise({.operator_name = "a", .to = "COMPROMISED", .reason = "x"}, [](const auto&) {});
  robot_->DeEscalate({.operator_name = "a",
                      .to = "DEFAULT",
                      .reason = "x",
                      .expected_level = "COMPROMISED",
                      .expected_decision_id = robot_->Status().decision_id},
                     [&](const LevelAnswer& got) { answer = got; });
  EXPECT_THAT(answer.status, StatusIs(absl::StatusCode::kFailedPrecondition,
                                      HasSubstr("RIPS does not see all of r1")));
}

TEST_F(MaintenanceTest, ANewCallReplacesTheEnd) {
  Start();
  Arm();
  ASSERT_THAT(Begin(60), IsOk());
  ASSERT_THAT(Begin(20), IsOk());
  EXPECT_THAT(audience_.alerts, Alert("medium",
                                      "until 2026-01-01 00:20:00 UTC, instead of until "
                                      "2026-01-01 01:00:00 UTC (asked by carol)"));
  Wait(20 * kMinute);
  EXPECT_EQ(robot_->Status().maintenance, std::nullopt);
  EXPECT_EQ(audience_.Count("the maintenance of r1 is over"), 1);
}

TEST_F(MaintenanceTest, AnOperatorEndsIt) {
  Start();
  Arm();
  EXPECT_THAT(
      End(), StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("r1 is in no maintenance")));
  ASSERT_THAT(Begin(), IsOk());
  EXPECT_FALSE(recorder_.maintenance.none());
  ASSERT_THAT(End(), IsOk());
  EXPECT_TRUE(recorder_.maintenance.none());
  EXPECT_THAT(audience_.alerts,
              Alert("info", "operator dave ends the maintenance of r1: it is back"));
  EXPECT_EQ(audience_.alerts.back().maintenance, "");
  LoseSensor();
  EXPECT_THAT(audience_.alerts, Alert("high", "sensor base is lost"));
}

TEST_F(MaintenanceTest, AgentsThatAreAbsentAtItsEndAreNamed) {
  Start();
  Arm();
  ASSERT_THAT(Begin(), IsOk());
  LoseSensor();
  LoseActuator();
  Wait(20 * kMinute);
  EXPECT_THAT(audience_.alerts,
              Alert("high",
                    "still absent after maintenance: sensor base, actuator base; the maintenance "
                    "of r1 is over (asked by carol: reboot)"));
  EXPECT_TRUE(recorder_.maintenance.none());
  Wait(kMinute);
  EXPECT_EQ(audience_.Count("is over"), 1) << "once";
}

// Else a short one would hide an agent that never comes back.
TEST_F(MaintenanceTest, AlsoWhenAnOperatorEndsIt) {
  Start();
  Arm();
  ASSERT_THAT(Begin(), IsOk());
  LoseSensor();
  ASSERT_THAT(End(), IsOk());
  EXPECT_THAT(audience_.alerts, Alert("high", "still absent after maintenance: sensor base; "));
}

TEST_F(MaintenanceTest, AtItsEndWithAllAgentsThereIsNothingToDo) {
  Start();
  Arm();
  ASSERT_THAT(Begin(1), IsOk());
  Pass(60'000);
  EXPECT_THAT(audience_.alerts, Alert("info", "the maintenance of r1 is over"));
  EXPECT_THAT(audience_.alerts, Not(Alert("high", "still absent")));
}

TEST_F(MaintenanceTest, ARestartOfTheServerKeepsIt) {
  Start();
  Arm();
  ASSERT_THAT(Begin(), IsOk());
  Restart();
  ASSERT_TRUE(robot_->Status().maintenance.has_value());
  EXPECT_EQ(robot_->Status().maintenance->reason, "reboot");
  Pass(6'000);
  EXPECT_THAT(audience_.alerts, Alert("info", "sensor base is lost"));
  EXPECT_THAT(audience_.alerts, Alert("info", "has not connected since this server started"));
  Wait(20 * kMinute);
  EXPECT_THAT(audience_.alerts,
              Alert("high", "still absent after maintenance: sensor base, actuator base"));
}

TEST_F(MaintenanceTest, OneThatEndedWhileTheServerWasAwayIsReported) {
  Start();
  Arm();
  ASSERT_THAT(Begin(), IsOk());
  clock_.Advance(21 * kMinute);
  Restart();
  EXPECT_EQ(robot_->Status().maintenance, std::nullopt);
  Pass(6'000);
  EXPECT_THAT(audience_.alerts, Alert("info", "the maintenance of r1 is over"));
  EXPECT_THAT(audience_.alerts, Alert("high", "sensor base is lost"));
  EXPECT_TRUE(recorder_.maintenance.none());
}

TEST_F(MaintenanceTest, WhatCannotBeRecordedDoesNotBeginButEnds) {
  Start();
  Arm();
  ASSERT_THAT(Begin(), IsOk());
  recorder_.fail = absl::UnavailableError("disk");
  LoseSensor();
  Wait(kNanosPerSecond);
  ASSERT_FALSE(recorder_.healthy());
  EXPECT_THAT(Begin(60), StatusIs(absl::StatusCode::kFailedPrecondition,
                                  HasSubstr("store cannot be written")));
  EXPECT_THAT(End(), IsOk());
  EXPECT_FALSE(recorder_.maintenance.none());
  recorder_.fail = absl::OkStatus();
  Wait(kNanosPerSecond);
  EXPECT_TRUE(recorder_.maintenance.none()) << "written when it can be";
}

TEST_F(MaintenanceTest, BadCallsChangeNothing) {
  Start();
  Arm();
  const size_t told = audience_.alerts.size();
  for (const std::string& reason : {std::string(), std::string(kReasonBytesMax + 1, 'r')}) {
    EXPECT_THAT(
        robot_->SetMaintenance({.operator_name = "a", .reason = reason, .for_ns = 20 * kMinute}),
        StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("1 to 1000 bytes")));
  }
  EXPECT_THAT(Begin(24 * 60 + 1),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("1 minute to 24 hours")));
  EXPECT_EQ(audience_.alerts.size(), told);
  EXPECT_EQ(robot_->Status().maintenance, std::nullopt);
  EXPECT_THAT(robot_->SetMaintenance({.operator_name = "a",
                                      .reason = std::string(kReasonBytesMax, '\n'),
                                      .for_ns = 20 * kMinute}),
              IsOk());
}

// An agent that comes and goes in a maintenance uses up nothing of what is said after it.
TEST_F(MaintenanceTest, AlertsInItUseUpNoRateOfThoseAfterIt) {
  Start();
  Arm();
  ASSERT_THAT(Begin(24 * 60), IsOk());
  for (int i = 0; i < 30; ++i) {
    LoseSensor();
    ConnectSensor();
  }
  EXPECT_LT(audience_.Count("sensor base is lost"), 30) << "folded";
  ASSERT_THAT(End(), IsOk());
  audience_.alerts.clear();
  LoseSensor();
  EXPECT_THAT(audience_.alerts, Alert("high", "sensor base is lost"));
}

}  // namespace
}  // namespace rips::pipeline
