#include "policy_server/server/shard/fair_turns.h"

#include <string>

#include "gtest/gtest.h"

namespace rips::pipeline {
namespace {

constexpr int64_t kMilli = kNanosPerMilli;

TEST(FairTurnsTest, TheNextTurnBelongsToTheRobotThatHasUsedTheLeast) {
  FairTurns<std::string> turns;
  turns.Ready("busy");
  turns.Ready("quiet");
  EXPECT_EQ(turns.Next(), "busy");
  turns.Charge("busy", 100 * kMilli);
  turns.Ready("busy");
  // However often the quiet one comes back, until it has used as much.
  for (int i = 0; i < 100; ++i) {
    ASSERT_EQ(turns.Next(), "quiet") << i;
    turns.Charge("quiet", 1 * kMilli + 1);
    turns.Ready("quiet");
  }
  EXPECT_EQ(turns.Next(), "busy");
}

TEST(FairTurnsTest, WaitingTwiceIsWaitingOnceAndTiesGoByArrival) {
  FairTurns<int> turns;
  for (const int who : {3, 1, 2, 3, 1}) turns.Ready(who);
  EXPECT_EQ(turns.Next(), 3);
  EXPECT_EQ(turns.Next(), 1);
  EXPECT_EQ(turns.Next(), 2);
  EXPECT_EQ(turns.Next(), std::nullopt);
  EXPECT_TRUE(turns.empty());
}

TEST(FairTurnsTest, IdlenessSavesNothingAndTimeAloneIsNoDebt) {
  FairTurns<std::string> turns;
  for (int i = 0; i < 10; ++i) {
    turns.Ready("alone");
    ASSERT_EQ(turns.Next(), "alone");
    turns.Charge("alone", 1'000 * kMilli);
  }
  turns.Ready("alone");
  turns.Ready("new");
  EXPECT_EQ(turns.Next(), "new") << "it is level with the turn served last, not with the debt";
  turns.Charge("new", 1'001 * kMilli);
  turns.Ready("new");
  EXPECT_EQ(turns.Next(), "alone") << "the new one did not save ten seconds";
}

TEST(FairTurnsTest, WhoHasLeftWaitsNoMore) {
  FairTurns<std::string> turns;
  turns.Ready("a");
  turns.Ready("b");
  turns.Forget("a");
  turns.Forget("unknown");
  EXPECT_EQ(turns.Next(), "b");
  EXPECT_TRUE(turns.empty());
}

TEST(CostMeterTest, ShortWorkCostsWhatItLastedAndLongWorkItsCpuTime) {
  int64_t cpu_ns = 1'000;
  int reads = 0;
  CostMeter meter([&] {
    ++reads;
    return cpu_ns;
  });
  meter.Sync();
  EXPECT_EQ(meter.Cost(50'000), 50'000);
  EXPECT_EQ(reads, 1) << "no system call for short work";
  cpu_ns += 50'000 + 3 * kMilli;
  EXPECT_EQ(meter.Cost(80 * kMilli), 3 * kMilli) << "others had the processor for the rest";
  cpu_ns += 90 * kMilli;
  EXPECT_EQ(meter.Cost(20 * kMilli), 20 * kMilli) << "never more than it lasted";
  EXPECT_EQ(meter.Cost(20 * kMilli), 0);
}

}  // namespace
}  // namespace rips::pipeline
