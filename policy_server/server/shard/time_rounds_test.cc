#include "policy_server/server/shard/time_rounds.h"

#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/clock.h"

namespace rips::pipeline {
namespace {

using ::testing::Each;

constexpr int64_t kStepNs = 50 * kNanosPerMilli;

// In how many parts of one round each robot is; part `late_at` is late by `late_ns`.
std::vector<int> PartsOfRobots(TimeRounds& time, size_t robots, int late_at = -1,
                               int64_t late_ns = 0) {
  std::vector<int> parts(robots, 0);
  int part = 0;
  do {
    time.Next(robots, part++ == late_at ? late_ns : 0);
    for (size_t i = 0; i < robots; ++i) parts[i] += time.Contains(i) ? 1 : 0;
  } while (!time.round_over());
  return parts;
}

TEST(TimeRoundsTest, FewAreOnePart) {
  TimeRounds time(kStepNs);
  time.Next(63, 0);
  EXPECT_TRUE(time.round_over());
  EXPECT_TRUE(time.Contains(62));
  EXPECT_EQ(time.part_ns(), kStepNs);
}

TEST(TimeRoundsTest, EachOfManyIsInOnePartOfARound) {
  TimeRounds time(kStepNs);
  EXPECT_THAT(PartsOfRobots(time, 500), Each(1));
  EXPECT_EQ(time.part_ns(), kStepNs / 10);
  time.Next(500, 0);
  EXPECT_FALSE(time.round_over());
  EXPECT_TRUE(time.Contains(10) && !time.Contains(11));
}

TEST(TimeRoundsTest, ALatePartIncludesMissedOnesAndNoRobotTwice) {
  for (int late_at = 0; late_at < 10; ++late_at) {
    for (const int64_t late_ns : {kStepNs / 10, kStepNs, 1'000 * kStepNs}) {
      TimeRounds time(kStepNs);
      EXPECT_THAT(PartsOfRobots(time, 500, late_at, late_ns), Each(1)) << late_at << " " << late_ns;
    }
  }
  TimeRounds time(kStepNs);
  time.Next(500, kStepNs);
  EXPECT_TRUE(time.round_over()) << "after a long task, one part has all robots";
}

TEST(TimeRoundsTest, ARoundIsOfThoseThatWereThereAtItsBeginning) {
  TimeRounds time(kStepNs);
  time.Next(64, 0);
  EXPECT_FALSE(time.round_over());
  time.Next(500, 0);
  EXPECT_TRUE(time.round_over()) << "of two parts still";
  EXPECT_THAT(PartsOfRobots(time, 500), Each(1));
}

TEST(TimeRoundsTest, APlaceStaysAndNoTwoShareOne) {
  TimeRounds time(kStepNs);
  EXPECT_EQ(time.Join(), 0u);
  EXPECT_EQ(time.Join(), 1u);
}

}  // namespace
}  // namespace rips::pipeline
