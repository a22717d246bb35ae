#include "sensor_agent/graph/graph_limits_watch.h"

#include "gtest/gtest.h"

namespace rips::sensor {
namespace {

constexpr int64_t kAsk = GraphLimitsWatch::kAskAgainNs;
constexpr int64_t kAnswer = GraphLimitsWatch::kAnswerNs;

TEST(GraphLimitsWatchTest, IsWholeAtFirst) {
  GraphLimitsWatch watch;
  EXPECT_FALSE(watch.is_short());
  EXPECT_FALSE(watch.Look(0, false, 10 * kAsk));
  EXPECT_FALSE(watch.is_short());
}

TEST(GraphLimitsWatchTest, IsShortUntilDiscoveryHasToldAllThatThereIs) {
  GraphLimitsWatch watch;
  EXPECT_FALSE(watch.Look(3, false, 100));
  EXPECT_TRUE(watch.is_short());
  EXPECT_FALSE(watch.Look(0, false, 99 + kAsk));
  EXPECT_TRUE(watch.Look(0, false, 100 + kAsk));
  EXPECT_FALSE(watch.Look(0, false, 101 + kAsk)) << "it is asked once";
  EXPECT_FALSE(watch.Look(0, false, 99 + kAsk + kAnswer));
  EXPECT_TRUE(watch.is_short());
  EXPECT_FALSE(watch.Look(0, false, 100 + kAsk + kAnswer));
  EXPECT_FALSE(watch.is_short());
  EXPECT_FALSE(watch.Look(0, false, 9 * kAsk));
}

TEST(GraphLimitsWatchTest, StaysShortAsLongAsThereIsNoRoom) {
  GraphLimitsWatch watch;
  int64_t now_ns = 100;
  watch.Look(1, false, now_ns);
  for (int i = 0; i < 5; ++i) {
    now_ns += kAsk;
    ASSERT_TRUE(watch.Look(0, false, now_ns));
    EXPECT_FALSE(watch.Look(1, false, now_ns + 1)) << "the answer does not fit either";
    EXPECT_TRUE(watch.is_short());
    EXPECT_FALSE(watch.Look(0, false, now_ns + kAnswer));
    EXPECT_TRUE(watch.is_short());
    ++now_ns;
  }
}

TEST(GraphLimitsWatchTest, AsksSoonWhenThereIsRoom) {
  GraphLimitsWatch watch;
  constexpr int64_t kRoom = GraphLimitsWatch::kRoomNs;
  int64_t now_ns = 2 * kAsk;
  watch.Look(1, false, now_ns);
  EXPECT_FALSE(watch.Look(0, true, now_ns + kRoom - 1));
  EXPECT_TRUE(watch.Look(0, true, now_ns + kRoom));
  // The answer did not fit: next time it waits twice as long, up to a minute.
  now_ns += kRoom + 1;
  watch.Look(1, true, now_ns);
  EXPECT_FALSE(watch.Look(0, true, now_ns + 2 * kRoom - 1));
  EXPECT_TRUE(watch.Look(0, true, now_ns + 2 * kRoom));
  now_ns += 2 * kRoom;
  EXPECT_FALSE(watch.Look(0, true, now_ns + kAnswer));
  EXPECT_FALSE(watch.is_short());
  // Soon again after it was whole for a while only.
  watch.Look(1, true, now_ns + kAnswer + 1);
  EXPECT_FALSE(watch.Look(0, true, now_ns + kAnswer + 1 + 2 * kRoom));
  now_ns += 3 * kAsk;
  EXPECT_TRUE(watch.Look(0, true, now_ns));
  EXPECT_FALSE(watch.Look(0, true, now_ns + kAnswer));
  now_ns += kAnswer + kAsk;
  watch.Look(1, true, now_ns);
  EXPECT_TRUE(watch.Look(0, true, now_ns + kRoom));
}

TEST(GraphLimitsWatchTest, AnotherQuestionIsAsGood) {
  GraphLimitsWatch watch;
  watch.Asked(1);
  EXPECT_FALSE(watch.is_short());
  watch.Look(1, false, 100);
  watch.Asked(200);
  EXPECT_FALSE(watch.Look(0, false, 200 + kAnswer));
  EXPECT_FALSE(watch.is_short());
}

}  // namespace
}  // namespace rips::sensor
