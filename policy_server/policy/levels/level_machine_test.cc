#include "policy_server/policy/levels/level_machine.h"

#include <algorithm>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "gmock/gmock.h"

namespace rips::levels {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr int64_t kSecond = kNanosPerSecond;

LevelTable Table(int size, int soft) {
  std::vector<Level> levels;
  for (int i = 0; i < size; ++i) {
    levels.push_back({.name = std::string(1, static_cast<char>('A' + i)), .soft = i == soft});
  }
  return LevelTable(std::move(levels));
}

LevelTable AllSoft() {
  return LevelTable({{"A", true}, {"B", true}, {"C", true}, {"D", true}, {"E", true}, {"F", true}});
}

Instant At(int64_t seconds) {
  return {.boottime_ns = seconds * kSecond, .unix_ns = (1'000'000 + seconds) * kSecond};
}

Cause Rule() { return {.kind = Cause::Kind::kRule, .name = "r"}; }
Cause Operator() { return {.kind = Cause::Kind::kOperator, .name = "ann", .reason = "checked"}; }

// The whole table of the header: from x request x soft or hard x what stands in the way.
TEST(LevelMachineTest, FollowsTheTableOfTheHeader) {
  constexpr int kLevels = 5;
  const Evidence blind{.blind_because = {"sensor lost", "backlog"}};
  for (int from = 0; from < kLevels; ++from) {
    for (int to = 0; to < kLevels; ++to) {
      for (const bool soft : {false, true}) {
        for (const bool late : {false, true}) {
          for (const bool see : {false, true}) {
            LevelMachine machine(Table(kLevels, soft ? from : -1), from, {3, 7}, 4);

            const Transition got = machine.Request(to, Rule(), At(50), see ? Evidence{} : blind,
                                                   late ? Lateness::kLate : Lateness::kTimely);

            Refusal want = Refusal::kNone;
            if (to < from) {
              want = !soft || to != from - 1 ? Refusal::kNeedsOperator
                     : late                  ? Refusal::kLate
                     : !see                  ? Refusal::kBlind
                                             : Refusal::kNone;
            }
            const bool decided = to != from && want == Refusal::kNone;
            SCOPED_TRACE(testing::Message() << from << " -> " << to << " soft " << soft << " late "
                                            << late << " see " << see);
            EXPECT_EQ(got.refusal, want);
            EXPECT_EQ(got.decided(), decided);
            EXPECT_EQ(got.decision_id, decided ? (DecisionId{4, 8}) : DecisionId{});
            EXPECT_EQ(got.based_on, (DecisionId{3, 7}));
            EXPECT_EQ(got.from, from);
            EXPECT_EQ(got.to, to);
            EXPECT_EQ(got.at, At(50));
            EXPECT_EQ(got.cause, Rule());
            EXPECT_EQ(got.detail.empty(), want == Refusal::kNone);
            EXPECT_EQ(machine.level(), decided ? to : from);
            EXPECT_EQ(machine.decision_id(), decided ? (DecisionId{4, 8}) : (DecisionId{3, 7}));
          }
        }
      }
    }
  }
}

TEST(LevelMachineTest, SaysWhatWasMissing) {
  LevelMachine machine(Table(3, 1), 1, {}, 1);

  const Transition blind = machine.Request(
      0, Rule(), At(1), {.blind_because = {"sensor lost", "backlog"}}, Lateness::kTimely);

  EXPECT_EQ(blind.detail, "sensor lost, backlog");
}

TEST(LevelMachineTest, RefusesALevelThatDoesNotExist) {
  for (const LevelIndex to : {-1, 3, std::numeric_limits<int>::max()}) {
    LevelMachine machine(Table(3, 1), 1, {}, 1);

    EXPECT_EQ(machine.Request(to, Rule(), At(1), {}, Lateness::kTimely).refusal,
              Refusal::kUnexpected);
    EXPECT_EQ(machine.Raise(to, Operator(), At(1)).refusal, Refusal::kUnexpected);
    EXPECT_EQ(machine.DeEscalate(to, Operator(), At(1), 1, {}).refusal, Refusal::kUnexpected);
    EXPECT_EQ(machine.level(), 1);
    EXPECT_TRUE(machine.decision_id().none());
  }
}

TEST(LevelMachineTest, SuspendsSoftLoweringsOverTheBudgetUntilResumed) {
  LevelMachine machine(AllSoft(), 5, {}, 1);
  for (int i = 0; i < 3; ++i) {
    EXPECT_TRUE(machine.Request(4 - i, Rule(), At(i), {}, Lateness::kTimely).lowers());
  }
  EXPECT_FALSE(machine.soft_suspended());

  EXPECT_EQ(machine.Request(1, Rule(), At(599), {}, Lateness::kTimely).refusal, Refusal::kBudget);
  EXPECT_TRUE(machine.soft_suspended());
  // Time alone does not end it.
  EXPECT_EQ(machine.Request(1, Rule(), At(100'000), {}, Lateness::kTimely).refusal,
            Refusal::kBudget);

  machine.Resume();
  EXPECT_FALSE(machine.soft_suspended());
  EXPECT_TRUE(machine.Request(1, Rule(), At(100'001), {}, Lateness::kTimely).lowers());
}

TEST(LevelMachineTest, CountsTheBudgetInASlidingWindow) {
  LevelMachine machine(AllSoft(), 5, {}, 1);
  for (int i = 0; i < 3; ++i) {
    EXPECT_TRUE(machine.Request(4 - i, Rule(), At(i), {}, Lateness::kTimely).lowers());
  }

  // The first one is 600 s old.
  EXPECT_TRUE(machine.Request(1, Rule(), At(600), {}, Lateness::kTimely).lowers());
  EXPECT_EQ(machine.Request(0, Rule(), At(600), {}, Lateness::kTimely).refusal, Refusal::kBudget);
}

TEST(LevelMachineTest, WhatWasSpentBeforeARestartIsSpent) {
  LevelMachine machine(AllSoft(), 5, {1, 7}, 2);
  machine.RestoreBudget({-100 * kNanosPerSecond, 0, 100 * kNanosPerSecond}, {1, 3});
  EXPECT_EQ(machine.resumed_at(), (DecisionId{1, 3}));
  // The first of the three is 600 s old.
  EXPECT_TRUE(machine.Request(4, Rule(), At(500), {}, Lateness::kTimely).lowers());
  EXPECT_EQ(machine.Request(3, Rule(), At(500), {}, Lateness::kTimely).refusal, Refusal::kBudget);
  EXPECT_TRUE(machine.soft_suspended());

  machine.Resume();
  EXPECT_EQ(machine.resumed_at(), (DecisionId{2, 8})) << "what led to the level that stands";
  for (int level = 3; level >= 1; --level) {
    EXPECT_TRUE(machine.Request(level, Rule(), At(501), {}, Lateness::kTimely).lowers());
  }
  EXPECT_EQ(machine.Request(0, Rule(), At(502), {}, Lateness::kTimely).refusal, Refusal::kBudget);
}

TEST(LevelMachineTest, RefusalsAndRaisesCostNoBudget) {
  LevelMachine machine(AllSoft(), 1, {}, 1);
  for (int i = 0; i < 10; ++i) {
    EXPECT_EQ(
        machine.Request(0, Rule(), At(i), {.blind_because = {"x"}}, Lateness::kTimely).refusal,
        Refusal::kBlind);
    EXPECT_EQ(machine.Request(0, Rule(), At(i), {}, Lateness::kLate).refusal, Refusal::kLate);
  }

  EXPECT_TRUE(machine.Request(5, Rule(), At(20), {}, Lateness::kTimely).decided());
  EXPECT_TRUE(machine.Request(4, Rule(), At(20), {}, Lateness::kTimely).lowers());
}

TEST(LevelMachineTest, SuspensionDoesNotHoldUpRaisesOrOperators) {
  LevelMachine machine(AllSoft(), 3, {}, 1, {.lowerings_max = 0});
  EXPECT_EQ(machine.Request(2, Rule(), At(0), {}, Lateness::kTimely).refusal, Refusal::kBudget);

  EXPECT_TRUE(machine.Request(4, Rule(), At(1), {}, Lateness::kTimely).decided());
  EXPECT_TRUE(machine.Raise(5, Operator(), At(1)).decided());
  EXPECT_TRUE(machine.DeEscalate(0, Operator(), At(1), 5, machine.decision_id()).lowers());
}

TEST(LevelMachineTest, OperatorRaisesOnlyUpwards) {
  LevelMachine machine(Table(4, -1), 2, {1, 1}, 1);

  EXPECT_EQ(machine.Raise(2, Operator(), At(0)).refusal, Refusal::kNotHigher);
  EXPECT_EQ(machine.Raise(1, Operator(), At(0)).refusal, Refusal::kNotHigher);
  const Transition up = machine.Raise(3, Operator(), At(0));

  EXPECT_EQ(up.decision_id, (DecisionId{1, 2}));
  EXPECT_EQ(up.cause, Operator());
}

TEST(LevelMachineTest, OperatorLowersOnlyWhatTheyHaveSeen) {
  const DecisionId decision_id{2, 9};
  LevelMachine machine(Table(4, -1), 3, decision_id, 2);

  EXPECT_EQ(machine.DeEscalate(0, Operator(), At(0), 2, decision_id).refusal, Refusal::kUnexpected);
  EXPECT_EQ(machine.DeEscalate(0, Operator(), At(0), 3, {2, 8}).refusal, Refusal::kUnexpected);
  EXPECT_EQ(machine.DeEscalate(0, Operator(), At(0), 3, {1, 9}).refusal, Refusal::kUnexpected);
  EXPECT_EQ(machine.DeEscalate(3, Operator(), At(0), 3, decision_id).refusal, Refusal::kNotLower);
  EXPECT_THAT(machine.DeEscalate(0, Operator(), At(0), 2, decision_id).detail, HasSubstr("`D`"));
  EXPECT_EQ(machine.level(), 3);
  const Transition down = machine.DeEscalate(0, Operator(), At(0), 3, decision_id);

  EXPECT_TRUE(down.lowers());
  EXPECT_EQ(down.decision_id, (DecisionId{2, 10}));
  EXPECT_EQ(down.based_on, decision_id);
  // The same click again finds another decision id.
  EXPECT_EQ(machine.DeEscalate(0, Operator(), At(0), 3, decision_id).refusal, Refusal::kUnexpected);
}

TEST(LevelMachineTest, AdoptsTheMoreRestrictiveAboveTheSeenDecisionId) {
  LevelMachine lower(Table(4, -1), 2, {1, 5}, 2);
  const Transition kept = lower.Adopt(1, {7, 40}, At(3));
  EXPECT_TRUE(kept.decided());
  EXPECT_EQ(kept.from, 2);
  EXPECT_EQ(kept.to, 2);
  EXPECT_EQ(kept.decision_id, (DecisionId{8, 41}));
  EXPECT_EQ(kept.cause.kind, Cause::Kind::kAdopted);

  LevelMachine higher(Table(4, -1), 2, {1, 5}, 2);
  const Transition raised = higher.Adopt(3, {1, 2}, At(3));
  EXPECT_EQ(raised.to, 3);
  EXPECT_EQ(raised.decision_id, (DecisionId{2, 6}));
  EXPECT_EQ(higher.level(), 3);
}

TEST(LevelMachineTest, AdoptMakesNoTermOfItsOwnAboveADecisionOfTheSameTerm) {
  LevelMachine machine(Table(4, -1), 1, {2, 5}, 2);

  EXPECT_EQ(machine.Adopt(2, {2, 5}, At(0)).decision_id, (DecisionId{2, 6}));
  EXPECT_EQ(machine.Adopt(2, {2, 40}, At(0)).decision_id, (DecisionId{2, 41}));
  EXPECT_EQ(machine.term(), 2u);
}

TEST(LevelMachineTest, AdoptTakesAnUnknownLevelForTheLast) {
  for (const LevelIndex level : {-1, 4}) {
    LevelMachine machine(Table(4, -1), 1, {}, 1);
    EXPECT_EQ(machine.Adopt(level, {1, 1}, At(0)).to, 3);
  }
}

TEST(LevelMachineTest, HostileDecisionIdsCannotUseUpTheCounters) {
  constexpr uint64_t kMax = std::numeric_limits<uint64_t>::max();
  LevelMachine machine(Table(4, -1), 1, {}, 1);

  DecisionId last = machine.Adopt(2, {kMax, kMax}, At(0)).decision_id;
  machine.RaiseTerm(kMax);
  for (int i = 0; i < 3; ++i) {
    const DecisionId next = machine.Adopt(2, {kMax, kMax}, At(0)).decision_id;
    EXPECT_GT(next, last);
    EXPECT_GT(next.epoch, last.epoch);
    last = next;
  }
}

TEST(LevelMachineTest, RaiseTermNeverLowersIt) {
  LevelMachine machine(Table(3, -1), 0, {}, 5);

  machine.RaiseTerm(3);
  EXPECT_EQ(machine.term(), 5u);
  machine.RaiseTerm(9);
  EXPECT_EQ(machine.Request(1, Rule(), At(0), {}, Lateness::kTimely).decision_id,
            (DecisionId{9, 1}));
}

TEST(LevelMachineTest, KeepsTheLevelByNameWhenTheTableIsSwapped) {
  LevelMachine machine(Table(3, -1), 1, {1, 1}, 1);

  EXPECT_FALSE(machine.SwapTable(LevelTable({{"A"}, {"X"}})));
  EXPECT_EQ(machine.table(), Table(3, -1));
  EXPECT_TRUE(machine.SwapTable(LevelTable({{"X"}, {"Y"}, {"Z"}, {"B"}})));

  EXPECT_EQ(machine.level(), 3);
  EXPECT_EQ(machine.decision_id(), (DecisionId{1, 1}));
}

TEST(LevelMachineTest, NamesEveryRefusal) {
  std::vector<std::string> names;
  for (int i = 1; i <= static_cast<int>(Refusal::kNotHigher); ++i) {
    names.emplace_back(ToString(static_cast<Refusal>(i)));
    EXPECT_THAT(names.back(), testing::Not(IsEmpty()));
  }
  std::sort(names.begin(), names.end());
  EXPECT_EQ(std::unique(names.begin(), names.end()), names.end());
  EXPECT_EQ(ToString(Refusal::kNone), "");
}

// One random call; checks the invariants of the header against the state before it.
void Step(std::mt19937& random, Instant now, LevelMachine& machine) {
  const auto pick = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
  const LevelIndex before = machine.level();
  const DecisionId decision_id = machine.decision_id();
  const bool suspended = machine.soft_suspended();
  const LevelIndex to = pick(8) - 1;
  const Evidence evidence{.blind_because = pick(3) == 0 ? std::vector<std::string>{"x"}
                                                        : std::vector<std::string>{}};
  const Lateness lateness = pick(4) == 0 ? Lateness::kLate : Lateness::kTimely;
  bool may_lower = false;
  Transition got;
  switch (pick(12)) {
    case 0:
      got = machine.Raise(to, Operator(), now);
      break;
    case 1: {
      const DecisionId expected =
          pick(2) == 0 ? decision_id : DecisionId{decision_id.term, decision_id.epoch + 1};
      got = machine.DeEscalate(to, Operator(), now, pick(2) == 0 ? before : to, expected);
      may_lower = expected == decision_id;
      break;
    }
    case 2:
      got = machine.Adopt(to, {random() % 50, random() % 5000}, now);
      EXPECT_TRUE(got.decided());
      break;
    case 3:
      machine.RaiseTerm(random() % 60);
      break;
    case 4:
      machine.Resume();
      break;
    default:
      got = machine.Request(to, Rule(), now, evidence, lateness);
      may_lower = machine.table().at(before).soft && to == before - 1 && !suspended &&
                  lateness == Lateness::kTimely && evidence.blind_because.empty();
  }
  EXPECT_TRUE(machine.level() >= before || may_lower);
  if (got.decided()) {
    EXPECT_GT(machine.decision_id().epoch, decision_id.epoch);
    EXPECT_GE(machine.decision_id().term, decision_id.term);
    EXPECT_EQ(got.decision_id, machine.decision_id());
    EXPECT_EQ(got.to, machine.level());
    EXPECT_EQ(got.from, before);
  } else {
    EXPECT_EQ(machine.level(), before);
    EXPECT_EQ(machine.decision_id(), decision_id);
  }
}

TEST(LevelMachineTest, HoldsItsInvariantsOnRandomWalks) {
  int lowered = 0;
  for (uint32_t seed = 1; seed <= 50; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    std::mt19937 random(seed);
    LevelMachine machine(
        LevelTable({{"A"}, {"B", true}, {"C", true}, {"D"}, {"E", true}, {"F", true}}), 0, {}, 1);
    int64_t now_s = 0;
    for (int i = 0; i < 2'000; ++i) {
      now_s += random() % 60;
      const LevelIndex before = machine.level();
      Step(random, At(now_s), machine);
      if (machine.level() < before) ++lowered;
      if (testing::Test::HasFailure()) return;
    }
  }
  // The walks do go down.
  EXPECT_GT(lowered, 1'000);
}

}  // namespace
}  // namespace rips::levels
