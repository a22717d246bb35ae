// The budget of soft lowerings is spent for its ten minutes, however often the server starts.
#include "policy_server/server/robot/decide/soft_lowerings.h"

#include <optional>
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/server/robot/robot_fixture.h"

namespace rips::pipeline {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::Optional;
using ::testing::StartsWith;
using ::testing::StrEq;

constexpr int64_t kMinute = 60 * kNanosPerSecond;

const levels::LevelTable& Table() {
  static const auto* table = new levels::LevelTable(
      {{.name = "DEFAULT"}, {.name = "ALERT", .soft = true}, {.name = "HALT"}});
  return *table;
}

constexpr Instant kNow{.boottime_ns = 5 * kMinute, .unix_ns = 1'000 * kMinute};

std::vector<int64_t> Lowered(std::vector<store::RuleDecision> decisions) {
  return SoftLowerings({.rule_decisions = std::move(decisions)}, Table(), kNow);
}
store::RuleDecision At(int64_t minute, const std::string& from = "ALERT",
                       const std::string& to = "DEFAULT") {
  return {.from = from, .to = to, .time_unix_ns = minute * kMinute};
}

TEST(SoftLoweringsTest, KeepTheirAgeAlsoFromBeforeTheHostsStart) {
  EXPECT_THAT(Lowered({}), IsEmpty());
  EXPECT_THAT(Lowered({At(990), At(998)}), ElementsAre(-5 * kMinute, 3 * kMinute));
}

TEST(SoftLoweringsTest, RaisesAreNone) {
  EXPECT_THAT(Lowered({At(998, "DEFAULT", "ALERT"), At(999, "ALERT", "ALERT")}), IsEmpty());
}

TEST(SoftLoweringsTest, ALevelThatTheBundleNoLongerHasCounts) {
  EXPECT_THAT(Lowered({At(998, "GONE", "DEFAULT"), At(999, "ALERT", "GONE")}),
              ElementsAre(3 * kMinute, 4 * kMinute));
}

TEST(SoftLoweringsTest, AClockThatContradictsItselfMakesThemYounger) {
  EXPECT_THAT(Lowered({At(1'500)}), ElementsAre(kNow.boottime_ns)) << "of the future";
  EXPECT_THAT(Lowered({At(998), At(900)}), ElementsAre(3 * kMinute, 3 * kMinute))
      << "set back between the two";
  EXPECT_THAT(Lowered({At(998, "DEFAULT", "ALERT"), At(900)}), ElementsAre(3 * kMinute))
      << "a raise shows it, too";
  EXPECT_THAT(Lowered({At(-1'000'000)}), ElementsAre(kNow.boottime_ns - kNow.unix_ns));
}

class SoftBudgetTest : public RobotTest {
 protected:
  // An intruder raises to ALERT, and rules want to lower when it has gone.
  void ComeAndGo() {
    IntruderAppears();
    if (Stage() != "verified") Obey();
    IntruderLeaves();
    Pass(7'000);
    if (Level() == "DEFAULT") Obey();
    Pass(100);
  }
  // The server as it starts on what the store has.
  void Restart() {
    store::RobotRecord record{.level = recorder_.decisions.back().to,
                              .decision_id = recorder_.decisions.back().decision_id,
                              .variables = recorder_.variables,
                              .high_water = recorder_.high_water,
                              .soft_suspended = recorder_.soft_suspended,
                              .resumed_at = recorder_.resumed_at};
    for (const store::DecisionRecord& each : recorder_.decisions) {
      if (each.decision_id <= record.resumed_at || !absl::StartsWith(each.cause, "rule ")) continue;
      record.rule_decisions.push_back({each.decision_id, each.from, each.to, each.time_unix_ns});
    }
    sensor_ = nullptr;
    actuator_ = nullptr;
    Start(kPaperRules, record, ++term_);
    ConnectSensor();
    ConnectActuator({.decision_id = record.decision_id,
                     .decided_level = record.level,
                     .effective_level = record.level,
                     .highest_term = term_ - 1});
    verified_ = true;
    SendSnapshot();
    Pass(6'000);
  }
  int Lowerings() const {
    int count = 0;
    for (const store::DecisionRecord& each : recorder_.decisions) {
      count += each.from == "ALERT" && each.to == "DEFAULT" ? 1 : 0;
    }
    return count;
  }

  uint64_t term_ = 1;
  static constexpr char kSpent[] = "rules have lowered the level 3 times in 10 minutes";
};

TEST_F(SoftBudgetTest, ARestartGivesNothingBackAndItIsToldOnce) {
  Start();
  Arm();
  for (int i = 0; i < 6; ++i) {
    ComeAndGo();
    Restart();
  }
  EXPECT_EQ(Lowerings(), 3);
  EXPECT_EQ(Level(), "ALERT");
  EXPECT_THAT(recorder_.refusals,
              Contains(Field(&store::RefusalRecord::reason, HasSubstr("budget"))));
  EXPECT_EQ(audience_.Count(kSpent), 1);
}

TEST_F(SoftBudgetTest, ASpentBudgetIsToldAgainOnlyAfterAnOperatorHasResumed) {
  Start();
  Arm();
  for (int i = 0; i < 5; ++i) ComeAndGo();
  EXPECT_EQ(Lowerings(), 3);
  EXPECT_EQ(audience_.Count(kSpent), 1);
  EXPECT_EQ(audience_.Count("`ripsctl rules resume r1 --reason TEXT`"), 1);

  EXPECT_TRUE(robot_->ResumeRules("alice", "maintenance").ok());
  Pass(1'000);
  EXPECT_EQ(Lowerings(), 4);
  Obey();
  for (int i = 0; i < 4; ++i) ComeAndGo();
  EXPECT_EQ(Lowerings(), 6);
  EXPECT_EQ(audience_.Count(kSpent), 2);
}

TEST_F(SoftBudgetTest, WhyRulesCannotLowerIsSaidBeforeTheyTry) {
  const auto why = [this] { return robot_->core().WhyRulesCannotLower(); };
  Start();
  Arm();
  EXPECT_EQ(why(), std::nullopt) << "there is no lower level";
  for (int i = 0; i < 3; ++i) ComeAndGo();
  IntruderAppears();
  ASSERT_EQ(Level(), "ALERT");
  Obey();
  constexpr char kLowered[] =
      "rules lowered the level 3 times within 10 minutes; an operator may resume them (`ripsctl "
      "rules resume r1 --reason TEXT`)";
  EXPECT_THAT(
      why(),
      Optional(StartsWith(absl::StrCat(kLowered, "; evidence has been complete for only 0."))));
  EXPECT_EQ(why(), why()) << "asking spends nothing";
  Pass(7'000);
  EXPECT_THAT(why(), Optional(StrEq(kLowered))) << "though no rule has asked for a fourth time";
  EXPECT_EQ(audience_.Count(kSpent), 0);
  EXPECT_TRUE(robot_->ResumeRules("alice", "maintenance").ok());
  EXPECT_THAT(why(), Optional(IsEmpty()));
  robot_->Raise({.operator_name = "alice", .to = "HALT", .reason = "drill"}, [](const auto&) {});
  EXPECT_THAT(why(), Optional(StrEq("`HALT` is not soft, so only a person may lower it")));
}

TEST_F(SoftBudgetTest, WhichRuleMayLowerIsSaidWithItsConditionNow) {
  const auto rules = [this] { return robot_->core().LoweringRules(); };
  Start();
  Arm();
  EXPECT_THAT(rules(), IsEmpty()) << "there is no lower level";
  IntruderAppears();
  ASSERT_EQ(Level(), "ALERT");
  ASSERT_EQ(rules().size(), 1);
  EXPECT_THAT(rules()[0].holds, Optional(false)) << "the intruder is there";
  EXPECT_THAT(rules()[0].trace.values, Not(IsEmpty()));
}

TEST_F(SoftBudgetTest, WhatAnOperatorGaveBackARestartDoesNotTake) {
  Start();
  Arm();
  for (int i = 0; i < 3; ++i) ComeAndGo();
  EXPECT_TRUE(robot_->ResumeRules("alice", "maintenance").ok());
  Drain();
  Restart();
  for (int i = 0; i < 3; ++i) ComeAndGo();
  EXPECT_EQ(Lowerings(), 6);
  EXPECT_EQ(audience_.Count(kSpent), 0);
  Restart();
  ComeAndGo();
  EXPECT_EQ(Lowerings(), 6);
  EXPECT_EQ(audience_.Count(kSpent), 1);
}

TEST_F(SoftBudgetTest, WhatIsTenMinutesOldIsNotSpentAnyMore) {
  Start();
  Arm();
  for (int i = 0; i < 3; ++i) ComeAndGo();
  clock_.Advance(10 * kMinute);
  Restart();
  ComeAndGo();
  EXPECT_EQ(Lowerings(), 4);
  EXPECT_EQ(audience_.Count(kSpent), 0);
}

TEST_F(SoftBudgetTest, AClockThatWasSetBackGivesNothingBack) {
  Start();
  Arm();
  for (int i = 0; i < 3; ++i) ComeAndGo();
  clock_.JumpUnix(-60 * kMinute);
  Restart();
  ComeAndGo();
  EXPECT_EQ(Lowerings(), 3);
}

}  // namespace
}  // namespace rips::pipeline
