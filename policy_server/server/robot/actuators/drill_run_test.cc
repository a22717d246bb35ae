#include "policy_server/server/robot/actuators/drill_run.h"

#include <map>
#include <variant>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/robot/actuators/receipt_history.h"

namespace rips::pipeline {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using Told = Receipt::Stage;

class DrillRunTest : public ::testing::Test {
 protected:
  // `host level` of what is sent now; remembers the ids.
  std::vector<std::string> Due() {
    std::vector<std::string> texts;
    for (const Outgoing& outgoing : run_.Due(7, now_)) {
      EXPECT_EQ(outgoing.command.term, 7u);
      const std::string level = std::get<Drill>(outgoing.command.what).level;
      texts.push_back(absl::StrCat(outgoing.host, " ", level));
      ids_[outgoing.host] = outgoing.command.id;
    }
    return texts;
  }
  void Answer(const std::string& host, Told stage, std::vector<StepResult> steps = {}) {
    EXPECT_TRUE(run_.OnReceipt(host, {.command_id = ids_[host],
                                      .stage = stage,
                                      .steps = std::move(steps),
                                      .detail = "as told"}));
  }
  // Of the last host at the last level. The run draws one for each of six tries when it begins.
  static std::string LastId() {
    IdSource same("id");
    for (int i = 0; i < 5; ++i) same.Next();
    return same.Next();
  }
  void Pass(int64_t ns) { now_.boottime_ns += ns; }

  Instant now_{.boottime_ns = 100, .unix_ns = 0};
  IdSource drawn_{"id"};
  std::map<std::string, std::string> ids_;
  DrillRun run_{
      {"DEFAULT", "ALERT"}, {{"arm", true}, {"away", false}, {"base", true}}, drawn_, now_};
};

TEST_F(DrillRunTest, LevelsComeInTurnOnEachActuator) {
  EXPECT_THAT(Due(), ElementsAre("arm DEFAULT", "base DEFAULT"));
  EXPECT_THAT(Due(), IsEmpty());
  Answer("arm", Told::kAcknowledged);
  Answer("arm", Told::kVerified, {{.step = "x", .ok = true}});
  EXPECT_THAT(Due(), ElementsAre("arm ALERT"));
  Answer("base", Told::kFailed);
  EXPECT_THAT(Due(), ElementsAre("base ALERT"));
  Answer("base", Told::kRefused);
  EXPECT_FALSE(run_.Over(now_));
  Answer("arm", Told::kVerified);
  EXPECT_TRUE(run_.Over(now_));

  const std::vector<DrillEntry> entries = run_.PopEntries();
  std::vector<std::string> texts;
  for (const DrillEntry& each : entries) {
    texts.push_back(absl::StrCat(each.level, " ", each.host, " ",
                                 each.stage ? static_cast<int>(*each.stage) : -1, " ",
                                 each.detail));
  }
  EXPECT_THAT(texts,
              ElementsAre("DEFAULT arm 2 as told", "DEFAULT away -1 the actuator is not attached",
                          "DEFAULT base 3 as told", "ALERT arm 2 as told",
                          "ALERT away -1 the actuator is not attached", "ALERT base 6 as told"));
  EXPECT_THAT(entries[0].steps, SizeIs(1));
  EXPECT_FALSE(AllWork(entries));
}

TEST_F(DrillRunTest, WhatIsNotAcknowledgedIsSentAgain) {
  EXPECT_THAT(Due(), SizeIs(2));
  const std::string id = ids_["base"];
  Answer("arm", Told::kAcknowledged);
  Pass(kDrillResendNs);
  EXPECT_THAT(Due(), ElementsAre("base DEFAULT"));
  EXPECT_EQ(ids_["base"], id);
  Answer("base", Told::kAcknowledged);
  Pass(kDrillResendNs);
  EXPECT_THAT(Due(), IsEmpty());
}

TEST_F(DrillRunTest, ALevelThatIsAppliedEndsThatActuatorsDrill) {
  Due();
  Answer("arm", Told::kSuperseded);
  EXPECT_THAT(Due(), IsEmpty());
  Answer("base", Told::kVerified);
  Due();
  Answer("base", Told::kVerified);
  ASSERT_TRUE(run_.Over(now_));
  const std::vector<DrillEntry> entries = run_.PopEntries();
  EXPECT_EQ(entries[3].stage, Told::kSuperseded);
  EXPECT_EQ(entries[3].detail, "not tried: as told");
  EXPECT_EQ(entries[5].stage, Told::kVerified);
}

TEST_F(DrillRunTest, OneThatGoesAwaySaysSo) {
  Due();
  run_.OnGone("arm");
  run_.OnGone("arm");
  EXPECT_THAT(Due(), IsEmpty());
  const std::vector<DrillEntry> entries = run_.PopEntries();
  EXPECT_EQ(entries[0].stage, Told::kUnknown);
  EXPECT_EQ(entries[0].detail, "the actuator went away during the drill");
  EXPECT_EQ(entries[3].detail, "not tried: the actuator went away");
}

TEST_F(DrillRunTest, TheTimeIsUpAtLast) {
  Due();
  Answer("base", Told::kAcknowledged);
  Pass(kDrillAnswerNs - 1);
  EXPECT_FALSE(run_.Over(now_));
  Pass(1);
  EXPECT_TRUE(run_.Over(now_));
  const std::vector<DrillEntry> entries = run_.PopEntries();
  EXPECT_FALSE(entries[2].stage.has_value());
  EXPECT_EQ(entries[2].detail, "no answer in time");
}

TEST_F(DrillRunTest, ReceiptsOfOthersAndRepeatedOnesChangeNothing) {
  Due();
  EXPECT_FALSE(run_.OnReceipt("base", {.command_id = "other", .stage = Told::kVerified}));
  EXPECT_FALSE(run_.OnReceipt("arm", {.command_id = ids_["base"], .stage = Told::kVerified}));
  Answer("base", Told::kFailed);
  Answer("base", Told::kVerified);
  Answer("base", Told::kAcknowledged);
  EXPECT_TRUE(run_.OnReceipt("base", {.command_id = LastId(), .stage = Told::kVerified}))
      << "of a level that nobody has asked for yet";
  EXPECT_THAT(Due(), ElementsAre("base ALERT"));
  EXPECT_EQ(run_.PopEntries()[2].stage, Told::kFailed);
}

TEST_F(DrillRunTest, AnswersAreHarmlessAndBounded) {
  Due();
  std::vector<StepResult> steps(300, {.step = "\x1b[2J", .output_tail = std::string(4096, 'x')});
  Answer("base", Told::kFailed, steps);
  const DrillEntry entry = run_.PopEntries()[2];
  ASSERT_THAT(entry.steps, SizeIs(kReceiptStepsKept));
  EXPECT_EQ(entry.steps[0].step, "\\x1b[2J");
  size_t bytes = 0;
  for (const StepResult& step : entry.steps) bytes += step.step.size() + step.output_tail.size();
  EXPECT_LE(bytes, kReceiptBytesKept);
}

TEST(DrillSummaryTest, CountsWhatWorksAndNamesTheRest) {
  std::vector<DrillEntry> drills = {
      {.level = "ALERT", .host = "base", .stage = Told::kVerified, .steps = {{.ok = true}}}};
  EXPECT_EQ(Summary(drills), "1 of 1 steps work");
  EXPECT_TRUE(AllWork(drills));
  drills.push_back({.level = "HALT",
                    .host = "base",
                    .stage = Told::kFailed,
                    .steps = {{.step = "program horn", .detail = "exit code 1"}, {.ok = true}},
                    .detail = "program horn: exit code 1"});
  drills.push_back({.level = "HALT", .host = "arm", .detail = "no answer in time"});
  EXPECT_EQ(
      Summary(drills),
      "2 of 3 steps work; these do not: base: program horn (HALT): exit code 1; arm: HALT: no "
      "answer in time");
  EXPECT_FALSE(AllWork(drills));
  drills[2].detail = std::string(5000, 'x');
  EXPECT_LE(Summary(drills).size(), 512u);
}

}  // namespace
}  // namespace rips::pipeline
