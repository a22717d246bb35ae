#include "policy_server/server/shard/time_rounds.h"

#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/clock.h"

namespace rips::pipeline {
namespace {

using ::testing::Each;

constexpr int64_t kStepNs = 50 * kNanosPerMilli;

// How often each robot is told in one round, in which part `late_at` is late by `late_ns`.
std::vector<int> Told(TimeRounds& time, size_t robots, int late_at = -1, int64_t late_ns = 0) {
  std::vector<int> told(robots, 0);
  int part = 0;
  do {
    time.Next(robots, part++ == late_at ? late_ns : 0);
    for (size_t i = 0; i < robots; ++i) told[i] += time.Contains(i) ? 1 : 0;
  } while (!time.round_over());
  return told;
}

TEST(TimeRoundsTest, FewAreToldInOneGo) {
  TimeRounds time(kStepNs);
  time.Next(63, 0);
  EXPECT_TRUE(time.round_over());
  EXPECT_TRUE(time.Contains(62));
  EXPECT_EQ(time.part_ns(), kStepNs);
}

TEST(TimeRoundsTest, ManyAreToldOnceEachRoundInParts) {
  TimeRounds time(kStepNs);
  EXPECT_THAT(Told(time, 500), Each(1));
  EXPECT_EQ(time.part_ns(), kStepNs / 10);
  time.Next(500, 0);
  EXPECT_FALSE(time.round_over());
  EXPECT_TRUE(time.Contains(10) && !time.Contains(11));
}

TEST(TimeRoundsTest, WhatWasMissedIsMadeUpForAndNobodyIsToldTwice) {
  for (int late_at = 0; late_at < 10; ++late_at) {
    for (const int64_t late_ns : {kStepNs / 10, kStepNs, 1'000 * kStepNs}) {
      TimeRounds time(kStepNs);
      EXPECT_THAT(Told(time, 500, late_at, late_ns), Each(1)) << late_at << " " << late_ns;
    }
  }
  TimeRounds time(kStepNs);
  time.Next(500, kStepNs);
  EXPECT_TRUE(time.round_over()) << "after a long task all are told at once";
}

TEST(TimeRoundsTest, ARoundIsOfThoseThatWereThereAtItsBeginning) {
  TimeRounds time(kStepNs);
  time.Next(64, 0);
  EXPECT_FALSE(time.round_over());
  time.Next(500, 0);
  EXPECT_TRUE(time.round_over()) << "of two parts still";
  EXPECT_THAT(Told(time, 500), Each(1));
}

TEST(TimeRoundsTest, APlaceStaysAndNoTwoShareOne) {
  TimeRounds time(kStepNs);
  EXPECT_EQ(time.Join(), 0u);
  EXPECT_EQ(time.Join(), 1u);
}

}  // namespace
}  // namespace rips::pipeline
