#include "policy_server/server/robot/sensors/sensor_health.h"

#include <limits>

#include "gmock/gmock.h"

namespace rips::pipeline {
namespace {

constexpr int64_t kMs = kNanosPerMilli;

// A server and a sensor whose wall clock is `ahead_ms` ahead; each way takes `way_ms`, and the
// sensor heartbeats `waits_ms` after the server's heartbeat has come.
class Heartbeats {
 public:
  bool Next(int64_t ahead_ms, int64_t way_ms = 1, int64_t waits_ms = 250) {
    server_.boottime_ns += 500 * kMs;
    server_.unix_ns += 500 * kMs;
    const int64_t echo_ns = server_.boottime_ns;
    const int64_t sent_ms = way_ms + waits_ms;
    const SensorHeartbeat heartbeat{
        .clock = {.boottime_ns = 7, .unix_ns = server_.unix_ns + (sent_ms + ahead_ms) * kMs},
        .echo_boottime_ns = echoes ? echo_ns : 0};
    const int64_t round_ms = sent_ms + way_ms;
    const Instant arrival{.boottime_ns = echo_ns + round_ms * kMs,
                          .unix_ns = server_.unix_ns + round_ms * kMs};
    return skew.Heartbeat(heartbeat, arrival);
  }

  ClockSkew skew;
  bool echoes = true;

 private:
  Instant server_{.boottime_ns = 1'000 * kNanosPerSecond, .unix_ns = 2'000 * kNanosPerSecond};
};

TEST(ClockSkewTest, AClockThatIsAheadIsOffAfterThreeHeartbeats) {
  Heartbeats heartbeats;
  EXPECT_EQ(heartbeats.skew.estimate_ns(), std::nullopt);
  EXPECT_FALSE(heartbeats.Next(600));
  EXPECT_FALSE(heartbeats.Next(600));
  EXPECT_FALSE(heartbeats.skew.off());
  EXPECT_TRUE(heartbeats.Next(600));
  EXPECT_TRUE(heartbeats.skew.off());
  EXPECT_EQ(heartbeats.skew.estimate_ns(), 599 * kMs) << "a way too low";
  EXPECT_FALSE(heartbeats.Next(600)) << "told once";
  EXPECT_FALSE(heartbeats.Next(0));
  EXPECT_FALSE(heartbeats.skew.off());
  EXPECT_FALSE(heartbeats.Next(600));
  EXPECT_FALSE(heartbeats.Next(600));
  EXPECT_TRUE(heartbeats.Next(600)) << "told again";
}

TEST(ClockSkewTest, AClockWithinTheLimitIsNotOff) {
  Heartbeats heartbeats;
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(heartbeats.Next(500));
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(heartbeats.Next(-500));
}

TEST(ClockSkewTest, AClockThatIsBehindIsOffIfTheRoundTripDoesNotExplainIt) {
  Heartbeats heartbeats;
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(heartbeats.Next(-700)) << "251 ms are explained";
  EXPECT_FALSE(heartbeats.Next(-800));
  EXPECT_FALSE(heartbeats.Next(-800));
  EXPECT_TRUE(heartbeats.Next(-800));
}

TEST(ClockSkewTest, ASlowNetworkIsNoSkew) {
  Heartbeats heartbeats;
  for (int i = 0; i < 20; ++i) EXPECT_FALSE(heartbeats.Next(0, 4'000));
  EXPECT_EQ(heartbeats.skew.estimate_ns(), -4'000 * kMs);
  heartbeats.Next(0, 2);
  EXPECT_EQ(heartbeats.skew.estimate_ns(), -2 * kMs) << "the closest counts";
}

TEST(ClockSkewTest, WithoutAnEchoOnlyAClockThatIsAheadIsFound) {
  Heartbeats heartbeats;
  heartbeats.echoes = false;
  for (int i = 0; i < 5; ++i) EXPECT_FALSE(heartbeats.Next(-60'000));
  EXPECT_FALSE(heartbeats.Next(60'000));
  EXPECT_FALSE(heartbeats.Next(60'000));
  EXPECT_TRUE(heartbeats.Next(60'000));
}

TEST(ClockSkewTest, TimesThatCannotBeDoNoHarm) {
  constexpr int64_t kMin = std::numeric_limits<int64_t>::min();
  constexpr int64_t kMax = std::numeric_limits<int64_t>::max();
  ClockSkew skew;
  for (const int64_t unix_ns : {kMin, int64_t{0}, kMax}) {
    for (const int64_t echo_ns : {kMin, int64_t{0}, int64_t{5}, kMax}) {
      skew.Heartbeat({.clock = {.unix_ns = unix_ns}, .echo_boottime_ns = echo_ns},
                     {.boottime_ns = 10, .unix_ns = 1'700'000'000 * kNanosPerSecond});
    }
  }
  EXPECT_TRUE(skew.off());
}

TEST(RestartCountTest, TheThirdRestartWithinTenMinutesIsTooMany) {
  RestartCount count;
  EXPECT_FALSE(count.Began("a", 0)) << "the first start is none";
  EXPECT_FALSE(count.Began("b", 1));
  EXPECT_FALSE(count.Began("b", 2)) << "the same process, connected again";
  EXPECT_FALSE(count.Began("c", 3));
  EXPECT_TRUE(count.Began("d", 4));
  EXPECT_FALSE(count.Began("e", 5)) << "counted anew";
  EXPECT_FALSE(count.Began("f", 6));
  EXPECT_TRUE(count.Began("g", 7));
}

TEST(RestartCountTest, OneRestartIsExpectedAfterOtherSettings) {
  RestartCount count;
  count.Began("a", 1);
  count.Expect(100);
  EXPECT_FALSE(count.Began("b", 2)) << "expected";
  EXPECT_FALSE(count.Began("c", 3));
  EXPECT_FALSE(count.Began("d", 4));
  EXPECT_TRUE(count.Began("e", 5)) << "the third that was not";
  count.Expect(100);
  EXPECT_FALSE(count.Began("f", 100)) << "too late, the first";
  EXPECT_FALSE(count.Began("g", 101));
  EXPECT_TRUE(count.Began("h", 102));
}

TEST(RestartCountTest, OldRestartsDoNotCount) {
  RestartCount count;
  count.Began("a", 0);
  count.Began("b", 1);
  count.Began("c", 2);
  EXPECT_FALSE(count.Began("d", 1 + RestartCount::kWithinNs));
  EXPECT_TRUE(count.Began("e", 1 + RestartCount::kWithinNs));
}

TEST(RecentLossesTest, HoldsTheLastTenMinutes) {
  RecentLosses losses;
  EXPECT_EQ(losses.Total(0), 0u);
  losses.Add(0, 0);
  losses.Add(3, 0);
  losses.Add(4, RecentLosses::kStepNs);
  EXPECT_EQ(losses.Total(RecentLosses::kWithinNs), 7u);
  EXPECT_EQ(losses.Total(RecentLosses::kWithinNs + RecentLosses::kStepNs), 4u);
  EXPECT_EQ(losses.Total(RecentLosses::kWithinNs + 2 * RecentLosses::kStepNs), 0u);
}

TEST(RecentLossesTest, StopsAtTheLargestNumber) {
  RecentLosses losses;
  losses.Add(UINT64_MAX, 0);
  losses.Add(5, 0);
  losses.Add(UINT64_MAX, RecentLosses::kStepNs);
  EXPECT_EQ(losses.Total(RecentLosses::kStepNs), UINT64_MAX);
}

}  // namespace
}  // namespace rips::pipeline
