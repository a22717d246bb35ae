#include "mode_actuator/steps/system_mode/mode_hold.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::actuator {
namespace {

using ::testing::HasSubstr;

constexpr int64_t kS = kNanosPerSecond;

ros2::Guid Manager(uint8_t number) {
  ros2::Guid guid;
  guid.bytes[15] = number;
  return guid;
}

TEST(ModeHoldTest, HeldByTheManagerIsNotDegraded) {
  ModeHold hold("/safety");
  EXPECT_EQ(hold.Degraded(0), "");
  hold.Reached("ALERT", "", Manager(1));
  EXPECT_TRUE(hold.holds("ALERT"));
  EXPECT_FALSE(hold.holds("HALT"));
  EXPECT_FALSE(hold.direct());
  EXPECT_EQ(hold.Degraded(0), "");
}

TEST(ModeHoldTest, HeldWithoutItIsDegradedUntilItAgrees) {
  ModeHold hold("/safety");
  hold.Reached("ALERT", "it lies", std::nullopt);
  EXPECT_TRUE(hold.direct());
  EXPECT_EQ(hold.Degraded(0), "/safety=ALERT is held without the mode manager: it lies");
  hold.Agreed();
  EXPECT_FALSE(hold.direct());
  EXPECT_EQ(hold.Degraded(0), "");
}

TEST(ModeHoldTest, EachManagerIsToldOnce) {
  ModeHold hold("/safety");
  hold.Reached("ALERT", "", Manager(1));
  EXPECT_FALSE(hold.IsNews(Manager(1)));
  EXPECT_TRUE(hold.IsNews(Manager(2)));
  hold.Notified(Manager(2));
  EXPECT_FALSE(hold.IsNews(Manager(2)));
  hold.Reached("HALT", "it is absent", std::nullopt);
  EXPECT_TRUE(hold.IsNews(Manager(2)));
}

TEST(ModeHoldTest, AManagerThatLeavesAModeTwiceAMinuteIsNotAskedForIt) {
  ModeHold hold("/safety");
  hold.Reached("ALERT", "", Manager(1));
  hold.Left("ALERT", "__DEFAULT__", 1 * kS);
  EXPECT_EQ(hold.WhyNotManager("ALERT", 1 * kS), "");
  hold.Left("ALERT", "__DEFAULT__", 61 * kS);  // the first is forgotten
  EXPECT_EQ(hold.WhyNotManager("ALERT", 61 * kS), "");
  hold.Left("ALERT", "OTHER", 62 * kS);
  EXPECT_EQ(hold.WhyNotManager("ALERT", 62 * kS),
            "the mode manager left ALERT for OTHER 2 times in 60 s; does its SMH file have rules, "
            "or does another node order it?");
  EXPECT_EQ(hold.WhyNotManager("HALT", 62 * kS), "");
  EXPECT_THAT(hold.Degraded(62 * kS), HasSubstr("/safety: the mode manager left ALERT"));
  EXPECT_EQ(hold.WhyNotManager("ALERT", 121 * kS), "");
}

TEST(ModeHoldTest, ForgetsWhatExceedsItsLimit) {
  ModeHold hold("/safety");
  hold.Left("ALERT", "X", 1 * kS);
  hold.Left("ALERT", "X", 1 * kS);
  for (size_t i = 0; i < kLeavesKept - 1; ++i) hold.Left("HALT", "X", 2 * kS);
  EXPECT_EQ(hold.WhyNotManager("ALERT", 2 * kS), "");
  EXPECT_THAT(hold.WhyNotManager("HALT", 2 * kS), HasSubstr("63 times"));
}

}  // namespace
}  // namespace rips::actuator
