// What is lost or not inspected is told with counts, once, and nobody can drown people in it.
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"
#include "policy_server/server/robot/sensors/loss_alarm.h"

namespace rips::pipeline {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::Pair;

TEST(LossAlarmTest, TellsBeginProgressAndEndWithCounts) {
  LossAlarm alarm;
  EXPECT_FALSE(alarm.Due(0).has_value());
  alarm.Add("outbox shed", 7, 0);
  alarm.Add("queue full", 2, 0);
  auto news = alarm.Due(0);
  ASSERT_TRUE(news.has_value());
  EXPECT_EQ(news->severity, engine::Severity::kHigh);
  EXPECT_EQ(news->text, "observations were lost: 7 (outbox shed); 2 (queue full)");

  int told = 0;
  for (int64_t second = 1; second < 60; ++second) {
    alarm.Add("outbox shed", 1, second * kNanosPerSecond);
    told += alarm.Due(second * kNanosPerSecond).has_value() ? 1 : 0;
  }
  EXPECT_EQ(told, 0) << "not for each";
  news = alarm.Due(60 * kNanosPerSecond);
  ASSERT_TRUE(news.has_value());
  EXPECT_THAT(news->text, HasSubstr("68 so far; since last told 59 (outbox shed)"));

  EXPECT_FALSE(alarm.Due(118 * kNanosPerSecond).has_value());
  news = alarm.Due(119 * kNanosPerSecond);
  ASSERT_TRUE(news.has_value());
  EXPECT_EQ(news->severity, engine::Severity::kInfo);
  EXPECT_THAT(news->text, HasSubstr("68 were lost in all"));
  EXPECT_FALSE(alarm.Due(500 * kNanosPerSecond).has_value());

  alarm.Add("queue full", 1, 500 * kNanosPerSecond);
  EXPECT_EQ(alarm.Due(500 * kNanosPerSecond)->text, "observations were lost: 1 (queue full)");
}

TEST(LossAlarmTest, CausesAndCountsHaveALimit) {
  LossAlarm alarm;
  for (int i = 0; i < 1'000; ++i) alarm.Add(absl::StrCat("cause ", i), 1, 0);
  alarm.Add("cause 0", ~uint64_t{0}, 0);
  const std::string text = alarm.Due(0)->text;
  EXPECT_THAT(text, HasSubstr("992 (other causes)"));
  EXPECT_THAT(text, HasSubstr("18446744073709551615 (cause 0)"));
}

using RobotLossTest = RobotTest;

LossSeen Loss(uint64_t count, bool tolerable = false) {
  return {.count = count, .cause = "a limit of the sensor was hit", .tolerable = tolerable};
}

TEST_F(RobotLossTest, ARunOfLossesIsOneAlertWithItsCount) {
  Start();
  Arm();
  for (int i = 0; i < 30; ++i) SendBatch(Lane::kControl, {{.what = Loss(10)}});
  Pass(1'000);
  EXPECT_EQ(audience_.Count("observations were lost: 300 (a limit of the sensor was hit)"), 1);
  EXPECT_EQ(audience_.Count("observations were lost"), 1);
  for (int i = 0; i < 30; ++i) SendBatch(Lane::kControl, {{.what = Loss(1)}});
  Pass(61'000);
  EXPECT_EQ(audience_.Count("330 were lost in all"), 1);
}

TEST_F(RobotLossTest, ABestEffortWritersGapsAreNoAlert) {
  Start();
  Arm();
  SendBatch(Lane::kControl, {{.what = Loss(10, /*tolerable=*/true)}});
  Pass(1'000);
  EXPECT_EQ(audience_.Count("are lost"), 0);
}

// 390 messages were judged and acknowledged; then a backup of the store from before was restored.
TEST_F(RobotLossTest, ARestoredStoreIsToldOnceAndIsNoLoss) {
  Start(kPaperRules, {.level = "ALERT", .decision_id = {1, 1}}, 2);
  const SpooledRange range{.incarnation = kIncarnation,
                           .lane = Lane::kMessages,
                           .first_sequence = 391,
                           .last_sequence = 390,
                           .acknowledged = 390};
  ConnectSensor({range});
  Pass(1'000);
  EXPECT_EQ(audience_.Count("a backup was restored"), 1);
  EXPECT_EQ(audience_.Count("are lost"), 0);
  EXPECT_EQ(robot_->core().sight().Coverage()[0].lost, 0u);

  robot_->OnSensorGone("base", sensor_.get());
  ConnectSensor({range});
  Pass(1'000);
  EXPECT_EQ(audience_.Count("a backup was restored"), 1) << "said once";
}

TEST_F(RobotLossTest, WhatWasShedIsLostAlsoWhenTheStoreWentBack) {
  Start();
  ConnectSensor({{.incarnation = kIncarnation,
                  .lane = Lane::kMessages,
                  .first_sequence = 401,
                  .last_sequence = 400,
                  .acknowledged = 390}});
  Pass(1'000);
  EXPECT_EQ(robot_->core().sight().Coverage()[0].lost, 10u);
}

TEST_F(RobotLossTest, ASensorThatDoesNotSayIsBelievedToHaveLost) {
  Start();
  ConnectSensor({{.incarnation = kIncarnation,
                  .lane = Lane::kMessages,
                  .first_sequence = 391,
                  .last_sequence = 390}});
  Pass(1'000);
  EXPECT_EQ(robot_->core().sight().Coverage()[0].lost, 390u);
  EXPECT_EQ(audience_.Count("observations were lost"), 1);
}

TEST_F(RobotLossTest, AStolenActuatorKeyCannotFloodAlerts) {
  Start();
  Arm();
  const size_t before = audience_.alerts.size();
  for (uint64_t i = 1; i <= 1'000; ++i) {
    drifts_ += 1;
    Heartbeat();
    clock_.Advance(10 * kNanosPerMilli);
  }
  Pass(1'000);
  EXPECT_LE(audience_.Count("the robot no longer is at"), 25);
  EXPECT_LE(audience_.alerts.size() - before, 60u);
  Pass(61'000);
  EXPECT_GE(audience_.Count("more alerts of this kind within a minute"), 1);
}

TEST_F(RobotLossTest, OnAFullDiskRaisesAreRecordedFromTheReserveAndLoweringsAreNot) {
  Start();
  Arm();
  recorder_.fail = absl::ResourceExhaustedError("the disk is full");
  recorder_.reserve = true;
  LevelAnswer answer;
  robot_->Raise({.operator_name = "alice", .to = "COMPROMISED", .reason = "drill"},
                [&](const LevelAnswer& a) { answer = a; });
  Drain();
  ASSERT_FALSE(recorder_.decisions.empty());
  EXPECT_EQ(recorder_.decisions.back().to, "COMPROMISED");
  EXPECT_EQ(Level(), "COMPROMISED");

  recorder_.fail = absl::OkStatus();
  Pass(2'000);
  const size_t known = recorder_.decisions.size();
  const DecisionId decision_id = robot_->Status().decision_id;
  recorder_.held = true;
  robot_->DeEscalate({.operator_name = "alice",
                      .to = "DEFAULT",
                      .reason = "drill",
                      .expected_level = "COMPROMISED",
                      .expected_decision_id = decision_id,
                      .accept_blind = true},
                     [](const LevelAnswer&) {});
  recorder_.fail = absl::ResourceExhaustedError("the disk is full");
  recorder_.held = false;
  recorder_.Release();
  Drain();
  for (size_t i = known; i < recorder_.decisions.size(); ++i) {
    EXPECT_NE(recorder_.decisions[i].to, "DEFAULT") << "a lowering that was taken back";
  }
  EXPECT_EQ(Level(), "COMPROMISED");
}

// Found by tests/simulation.
TEST_F(RobotLossTest, ARaiseAfterALoweringThatCannotBeRecordedIsNotSavedBelowWhatWasHeld) {
  Start();
  Arm();
  const auto order = [&](const std::string& to) {
    return LevelOrder{.operator_name = "alice",
                      .to = to,
                      .reason = "drill",
                      .expected_level = Level(),
                      .expected_decision_id = robot_->Status().decision_id,
                      .accept_blind = true};
  };
  const auto ignore = [](const LevelAnswer&) {};
  robot_->Raise(order("HALT"), ignore);
  Drain();
  const size_t known = recorder_.decisions.size();
  recorder_.held = true;
  robot_->DeEscalate(order("ALERT"), ignore);
  robot_->Raise(order("COMPROMISED"), ignore);
  recorder_.fail = absl::ResourceExhaustedError("the disk is full");
  recorder_.reserve = true;
  recorder_.held = false;
  recorder_.Release();
  Drain();
  for (size_t i = known; i < recorder_.decisions.size(); ++i) {
    EXPECT_EQ(recorder_.decisions[i].to, "HALT");
  }
  EXPECT_EQ(Level(), "HALT");
}

// Found by tests/simulation: a batch that succeeds after one that failed recorded the sequences of
// both.
TEST_F(RobotLossTest, OneBatchIsRecordedAtATime) {
  Start();
  Arm();
  recorder_.held = true;
  const auto ignore = [](const LevelAnswer&) {};
  robot_->Raise({.operator_name = "alice", .to = "ALERT", .reason = "drill"}, ignore);
  robot_->Raise({.operator_name = "alice", .to = "HALT", .reason = "drill"}, ignore);
  EXPECT_EQ(recorder_.waiting(), 1u);
  recorder_.held = false;
  recorder_.Release();
  Drain();
  EXPECT_EQ(recorder_.decisions.back().to, "HALT");
}

TEST_F(RobotLossTest, AlertsThatFoundNoRoomInAnOutageAreCounted) {
  Start(R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules External:
  a: false ? trigger(ALERT);
  b: false ? trigger(COMPROMISED);
  c: false ? trigger(HALT);
rules Msg:
  each: topicin("/cmd_vel") ? alert("seen");
)");
  Arm();
  recorder_.fail = absl::UnavailableError("disk on fire");
  for (int i = 0; i < 120; ++i) {
    for (int j = 0; j < 15; ++j) SendMessage(2);
    Pass(1'000);
  }
  recorder_.fail = absl::OkStatus();
  Pass(3'000);
  EXPECT_EQ(audience_.Count("alerts were dropped while the store could not be written"), 1);
}

TEST_F(RobotLossTest, SkippedInspectionsAreCountedByReasonAndShown) {
  absl::btree_map<std::string, uint64_t> counted;
  counts_.inspections_skipped = [&](const std::string& reason, uint64_t by) {
    counted[reason] += by;
  };
  Start(R"(
levels: DEFAULT; ALERT soft; COMPROMISED; HALT;
rules External:
  a: false ? trigger(ALERT);
  b: false ? trigger(COMPROMISED);
  c: false ? trigger(HALT);
rules Msg:
  bad: topicin("/image") && plugin("look") ? alert("bad");
)");
  Arm();
  const auto send = [&](const std::string& payload, uint32_t size) {
    SendBatch(Lane::kMessages, {{.what = MessageSeen{.topic = "/image",
                                                     .type = "sensor_msgs/msg/Image",
                                                     .writer = Writer(2),
                                                     .size_bytes = size,
                                                     .payload = payload,
                                                     .truncated = payload.size() < size}}});
  };
  send("", 100);
  inspector_->Answer(engine::Verdict::kUnscanned);
  Drain();
  send("xxx", 100);
  inspector_->Answer(engine::Verdict::kUnscanned);
  Drain();
  send("xxx", 3);
  inspector_->Answer(engine::Verdict::kUnscanned);
  Drain();
  send("xxx", 3);
  inspector_->Answer(engine::Verdict::kNo);
  Drain();

  const auto each_once =
      ElementsAre(Pair("cut payload", 1u), Pair("no payload", 1u), Pair("not answered", 1u));
  EXPECT_THAT(robot_->core().losses().Skipped(), each_once);
  EXPECT_THAT(counted, each_once);
  EXPECT_THAT(robot_->Status().degraded,
              Contains(HasSubstr("were not inspected in the last ten minutes: cut payload, no "
                                 "payload, not answered")));
  Pass(620'000);
  EXPECT_THAT(robot_->core().losses().Skipped(), IsEmpty());
  EXPECT_THAT(robot_->Status().degraded, Not(Contains(HasSubstr("not inspected"))));
}

}  // namespace
}  // namespace rips::pipeline
