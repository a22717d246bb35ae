#include "sensor_agent/graph_limits_watch.h"

#include "gtest/gtest.h"

namespace rips::sensor {
namespace {

constexpr int64_t kAsk = GraphLimitsWatch::kAskAgainNs;
constexpr int64_t kAnswer = GraphLimitsWatch::kAnswerNs;

TEST(GraphLimitsWatchTest, IsWholeAtFirst) {
  GraphLimitsWatch watch;
  EXPECT_FALSE(watch.is_short());
  EXPECT_FALSE(watch.Look(0, 10 * kAsk));
  EXPECT_FALSE(watch.is_short());
}

TEST(GraphLimitsWatchTest, IsShortUntilDiscoveryHasToldAllThatThereIs) {
  GraphLimitsWatch watch;
  EXPECT_FALSE(watch.Look(3, 100));
  EXPECT_TRUE(watch.is_short());
  EXPECT_FALSE(watch.Look(0, 99 + kAsk));
  EXPECT_TRUE(watch.Look(0, 100 + kAsk));
  EXPECT_FALSE(watch.Look(0, 101 + kAsk)) << "it is asked once";
  EXPECT_FALSE(watch.Look(0, 99 + kAsk + kAnswer));
  EXPECT_TRUE(watch.is_short());
  EXPECT_FALSE(watch.Look(0, 100 + kAsk + kAnswer));
  EXPECT_FALSE(watch.is_short());
  EXPECT_FALSE(watch.Look(0, 9 * kAsk));
}

TEST(GraphLimitsWatchTest, StaysShortAsLongAsThereIsNoRoom) {
  GraphLimitsWatch watch;
  int64_t now_ns = 100;
  watch.Look(1, now_ns);
  for (int i = 0; i < 5; ++i) {
    now_ns += kAsk;
    ASSERT_TRUE(watch.Look(0, now_ns));
    EXPECT_FALSE(watch.Look(1, now_ns + 1)) << "the answer does not fit either";
    EXPECT_TRUE(watch.is_short());
    EXPECT_FALSE(watch.Look(0, now_ns + kAnswer));
    EXPECT_TRUE(watch.is_short());
    ++now_ns;
  }
}

}  // namespace
}  // namespace rips::sensor
