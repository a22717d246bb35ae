#include "services/rpc/flood_watch.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::rpc {
namespace {

using ::testing::StartsWith;

class FloodWatchTest : public ::testing::Test {
 protected:
  void Seconds(int64_t seconds) { now_ns_ += seconds * kNanosPerSecond; }
  std::optional<FloodWatch::Flood> Count(const std::string& address, int times = 1) {
    std::optional<FloodWatch::Flood> last;
    for (int i = 0; i < times; ++i) {
      auto flood = watch_.Count(address, now_ns_);
      EXPECT_FALSE(last && flood) << "told twice";
      if (flood) last = std::move(flood);
    }
    return last;
  }

  int64_t now_ns_ = 1'000 * kNanosPerSecond;
  FloodWatch watch_{{.of_source = 5, .of_all = 20}};
};

TEST_F(FloodWatchTest, AnAddressIsToldWhenItHasSoManyInOneWindow) {
  EXPECT_FALSE(Count("10.0.0.1", 4));
  Seconds(3);
  const auto flood = Count("10.0.0.1");
  ASSERT_TRUE(flood);
  EXPECT_EQ(flood->source, "10.0.0.1");
  EXPECT_EQ(flood->sources, 1u);
  EXPECT_EQ(flood->refused, 5);
  EXPECT_EQ(flood->within_ns, 3 * kNanosPerSecond);
}

TEST_F(FloodWatchTest, WhoReconnectsNowAndThenIsNotTold) {
  for (int i = 0; i < 50; ++i) {
    EXPECT_FALSE(Count("10.0.0.1", 4));
    Seconds(10);
  }
}

TEST_F(FloodWatchTest, AnAddressIsToldOnceAMinute) {
  EXPECT_TRUE(Count("10.0.0.1", 1'000));
  for (int i = 0; i < 5; ++i) {
    Seconds(10);
    EXPECT_FALSE(Count("10.0.0.1", 1'000));
  }
  Seconds(10);
  EXPECT_TRUE(Count("10.0.0.1", 1'000));
}

TEST_F(FloodWatchTest, ALoudAddressHidesNoOther) {
  EXPECT_TRUE(Count("10.0.0.1", 1'000));
  EXPECT_TRUE(Count("10.0.0.2", 5));
}

TEST_F(FloodWatchTest, ManyQuietAddressesAreToldTogether) {
  for (int i = 0; i < 19; ++i) EXPECT_FALSE(Count(absl::StrCat("10.0.0.", i)));
  const auto flood = Count("10.0.0.19");
  ASSERT_TRUE(flood);
  EXPECT_EQ(flood->sources, 20u);
  EXPECT_EQ(flood->refused, 20);
  EXPECT_EQ(flood->of_source, 1);
  EXPECT_THAT(flood->source, StartsWith("10.0.0."));
  EXPECT_FALSE(Count("10.0.0.20"));
  Seconds(60);
  for (int i = 0; i < 19; ++i) EXPECT_FALSE(Count(absl::StrCat("10.0.0.", i)));
  EXPECT_TRUE(Count("10.0.0.19"));
}

TEST_F(FloodWatchTest, ALoudAddressIsNotCountedWithTheQuietOnes) {
  EXPECT_TRUE(Count("10.0.0.1", 1'000));
  for (int i = 0; i < 19; ++i) EXPECT_FALSE(Count(absl::StrCat("10.0.1.", i)));
  const auto flood = Count("10.0.1.19");
  ASSERT_TRUE(flood);
  EXPECT_EQ(flood->sources, 20u);
  EXPECT_EQ(flood->refused, 20);
}

TEST_F(FloodWatchTest, DecoysLeaveAnAddressInTheTotalWhichNamesTheMost) {
  FloodWatch watch({.of_source = 5, .of_all = 20, .named = 3});
  int named = 0;
  std::optional<FloodWatch::Flood> all;
  for (int i = 0; i < 40 * 5; ++i) {
    const auto flood = watch.Count(absl::StrCat("10.0.0.", i % 40), now_ns_);
    if (!flood) continue;
    named += flood->sources == 1 ? 1 : 0;
    if (flood->sources > 1) all = flood;
  }
  EXPECT_EQ(named, 3);
  ASSERT_TRUE(all);
  EXPECT_EQ(all->refused, 20);
  now_ns_ += 60 * kNanosPerSecond;
  for (int i = 0; i < 10; ++i) EXPECT_TRUE(!watch.Count("10.0.1.1", now_ns_) || i == 4);
  for (int i = 0; i < 15; ++i) EXPECT_FALSE(watch.Count("10.0.1.2", now_ns_));
  for (int i = 0; i < 4; ++i) EXPECT_FALSE(watch.Count(absl::StrCat("10.0.2.", i), now_ns_));
  all = watch.Count("10.0.3.3", now_ns_);
  ASSERT_TRUE(all) << "one more is named in each minute, the second stays in the total";
  EXPECT_EQ(all->source, "10.0.1.2");
  EXPECT_EQ(all->of_source, 15);
  EXPECT_EQ(all->refused, 20);
  EXPECT_EQ(all->sources, 6u);
}

TEST_F(FloodWatchTest, MoreAddressesThanItRemembersAreStillCounted) {
  FloodWatch watch({.of_source = 5, .of_all = 20'000});
  std::optional<FloodWatch::Flood> flood;
  for (int i = 0; i < 20'000; ++i) {
    flood = watch.Count(absl::StrCat("10.", i / 65'536, ".", i / 256 % 256, ".", i % 256), now_ns_);
  }
  ASSERT_TRUE(flood);
  EXPECT_EQ(flood->refused, 20'000);
  EXPECT_GE(flood->sources, 8'192u);
}

TEST_F(FloodWatchTest, ManyAddressesDoNotHideTheOneThatCameBeforeThem) {
  FloodWatch watch({.of_source = 5, .of_all = 1'000'000});
  EXPECT_FALSE(watch.Count("10.9.9.9", now_ns_));
  for (int i = 0; i < 10'000; ++i) watch.Count(absl::StrCat("address ", i), now_ns_);
  for (int i = 0; i < 3; ++i) EXPECT_FALSE(watch.Count("10.9.9.9", now_ns_));
  const auto flood = watch.Count("10.9.9.9", now_ns_);
  ASSERT_TRUE(flood);
  EXPECT_EQ(flood->source, "10.9.9.9");
}

}  // namespace
}  // namespace rips::rpc
