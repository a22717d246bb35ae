#include "mode_actuator/decide/drift_watch.h"

#include "gtest/gtest.h"

namespace rips::actuator {
namespace {

constexpr int64_t kS = kNanosPerSecond;

TEST(DriftWatchTest, IsDueAtTheThirdTimeAndOncePerWindow) {
  DriftWatch watch;
  watch.Left(1 * kS);
  watch.Left(2 * kS);
  EXPECT_FALSE(watch.PopDue(2 * kS));
  EXPECT_EQ(watch.Degraded("ALERT", 2 * kS), "");
  watch.Left(3 * kS);
  EXPECT_EQ(watch.Degraded("ALERT", 3 * kS), "ALERT was left again and again: 3 times in 60 s");
  EXPECT_TRUE(watch.PopDue(3 * kS));
  EXPECT_FALSE(watch.PopDue(3 * kS));
  watch.Ran("");
  for (int64_t at = 4; at < 63; ++at) watch.Left(at * kS);
  EXPECT_FALSE(watch.PopDue(62 * kS));
  watch.Left(63 * kS);
  EXPECT_TRUE(watch.PopDue(63 * kS));
}

TEST(DriftWatchTest, WhatIsLongAgoDoesNotCount) {
  DriftWatch watch;
  for (int64_t at : {1, 30, 61, 91}) watch.Left(at * kS);
  EXPECT_FALSE(watch.PopDue(91 * kS));
  watch.Left(92 * kS);
  EXPECT_TRUE(watch.PopDue(92 * kS));
}

TEST(DriftWatchTest, TellsWhatFollowedAndEnds) {
  DriftWatch watch;
  for (int64_t at : {1, 2, 3}) watch.Left(at * kS);
  ASSERT_TRUE(watch.PopDue(3 * kS));
  watch.Ran("program horn: exit code 1");
  EXPECT_EQ(watch.Degraded("ALERT", 4 * kS),
            "ALERT was left again and again: 3 times in 60 s; its on_drift steps failed: program "
            "horn: exit code 1");
  watch.Ran("");
  EXPECT_EQ(watch.Degraded("ALERT", 62 * kS),
            "ALERT was left again and again: 1 times in 60 s; its on_drift steps were run");
  EXPECT_EQ(watch.Degraded("ALERT", 63 * kS), "");
}

TEST(DriftWatchTest, AnotherLevelStartsAnew) {
  DriftWatch watch;
  for (int64_t at : {1, 2, 3}) watch.Left(at * kS);
  watch.Reset();
  EXPECT_FALSE(watch.PopDue(3 * kS));
  watch.Left(4 * kS);
  EXPECT_FALSE(watch.PopDue(4 * kS));
}

}  // namespace
}  // namespace rips::actuator
