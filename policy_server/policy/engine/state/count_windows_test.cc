#include "policy_server/policy/engine/state/count_windows.h"

#include <algorithm>
#include <deque>
#include <limits>
#include <random>
#include <string>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"

namespace rips::engine {
namespace {

TEST(CountWindowsTest, CountsWhatIsLaterThanTheStartOfTheWindow) {
  CountWindows windows;
  EXPECT_EQ(windows.Count("/a", 100, 100), 0u);
  for (const int64_t time : {0, 50, 50, 100}) windows.Add("/a", time, 1'000);
  windows.Add("/b", 100, 1'000);
  EXPECT_EQ(windows.Count("/a", 100, 1), 1u);
  EXPECT_EQ(windows.Count("/a", 100, 50), 1u) << "the start itself is outside";
  EXPECT_EQ(windows.Count("/a", 100, 51), 3u);
  EXPECT_EQ(windows.Count("/a", 100, 100), 3u);
  EXPECT_EQ(windows.Count("/a", 100, 101), 4u);
  EXPECT_EQ(windows.Count("/b", 100, 101), 1u);
  EXPECT_EQ(windows.Count("/a", 1'000'000, 100), 0u);
}

TEST(CountWindowsTest, TheEndsOfTheClock) {
  CountWindows windows;
  constexpr int64_t kMin = std::numeric_limits<int64_t>::min();
  constexpr int64_t kMax = std::numeric_limits<int64_t>::max();
  windows.Add("/a", kMin, kMax);
  EXPECT_EQ(windows.Count("/a", kMin, kMax), 0u) << "nothing is later than the smallest time";
  windows.Add("/a", kMax, kMax);
  EXPECT_EQ(windows.Count("/a", kMax, kMax), 1u);
}

// Against all times kept.
TEST(CountWindowsTest, AreExactUpToTheLimitAndNeverTooLowBeyond) {
  std::mt19937 random(1);
  for (const int64_t step_max : {int64_t{4'000'000}, int64_t{400'000}, int64_t{20'000}}) {
    CountWindows windows;
    std::deque<int64_t> times;
    int64_t now = 0;
    constexpr int64_t kWindow = 1'000'000'000;
    for (int i = 0; i < 200'000; ++i) {
      now += static_cast<int64_t>(random() % step_max);
      windows.Add("/a", now, kWindow);
      times.push_back(now);
      while (times.front() <= now - kWindow) times.pop_front();
      const uint64_t count = windows.Count("/a", now, kWindow);
      if (times.size() < CountWindows::kExactMax) {
        ASSERT_EQ(count, times.size()) << i;
      } else {
        ASSERT_GE(count, times.size()) << i;
        ASSERT_LE(count, times.size() * 101 / 100 + 1) << i;
      }
    }
  }
}

TEST(CountWindowsTest, WhatWasLostIsSpreadOverItsTime) {
  CountWindows windows;
  windows.Add("/a", 0, 10'000);
  windows.Add("/a", 500, 10'000);
  windows.AddLost("/a", 4, 100, 500, 10'000);
  EXPECT_EQ(windows.Count("/a", 500, 600), 6u);
  EXPECT_EQ(windows.Count("/a", 500, 300), 4u) << "at 300, 400 and 500, and the one that came";
  EXPECT_EQ(windows.Count("/a", 500, 1), 2u);
  windows.AddLost("/b", 1'000, 500, 500, 10'000);
  EXPECT_EQ(windows.Count("/b", 500, 1), 1'000u) << "all at once";
  windows.AddLost("/b", 0, 0, 500, 10'000);
  windows.AddLost("/c", 0, 0, 500, 10'000);
  EXPECT_EQ(windows.Count("/b", 500, 1'000), 1'000u);
  EXPECT_EQ(windows.keys(), 2u);
  windows.Add("/b", 500, 10'000);
  windows.Add("/b", 600, 10'000);
  EXPECT_EQ(windows.Count("/b", 600, 101), 1'002u);
}

TEST(CountWindowsTest, MoreThanThePartsComesToTheSame) {
  CountWindows windows;
  const uint64_t count = (uint64_t{1} << 32) + 7;
  windows.AddLost("/a", count, 0, 6'400, 100'000);
  EXPECT_EQ(windows.Count("/a", 6'400, 6'400), count);
  const uint64_t half = windows.Count("/a", 6'400, 3'200);
  EXPECT_GE(half, count / 2);
  EXPECT_LE(half, count / 2 + CountWindows::kSpreadMax);
}

// Against all times kept, where losses are told late and out of order.
TEST(CountWindowsTest, AreNeverTooLowWhereMessagesAreLost) {
  std::mt19937 random(2);
  CountWindows windows;
  std::deque<int64_t> times;
  int64_t now = 10'000'000'000;
  constexpr int64_t kWindow = 1'000'000'000;
  for (int i = 0; i < 20'000; ++i) {
    now += static_cast<int64_t>(random() % 4'000'000);
    if (random() % 10 == 0) {
      const int64_t last = now - static_cast<int64_t>(random() % 1'500'000'000);
      const int64_t first = last - static_cast<int64_t>(random() % 1'500'000'000);
      const auto lost = static_cast<int64_t>(1 + random() % CountWindows::kSpreadMax);
      windows.AddLost("/a", static_cast<uint64_t>(lost), first, last, kWindow);
      for (int64_t k = 1; k <= lost; ++k) {
        times.push_back(first == last ? last : last - (last - first) / lost * (lost - k));
      }
    } else {
      windows.Add("/a", now, kWindow);
      times.push_back(now);
    }
    std::sort(times.begin(), times.end());
    while (times.front() <= now - kWindow) times.pop_front();
    const uint64_t count = windows.Count("/a", now, kWindow);
    ASSERT_GE(count, times.size()) << i;
    ASSERT_LE(count, times.size() * 101 / 100 + 64) << i;
    ASSERT_GE(windows.Count("/a", now, kWindow / 3),
              static_cast<uint64_t>(
                  times.end() - std::upper_bound(times.begin(), times.end(), now - kWindow / 3)));
  }
}

TEST(CountWindowsTest, TheEndsOfTheClockWhereMessagesAreLost) {
  CountWindows windows;
  constexpr int64_t kMin = std::numeric_limits<int64_t>::min();
  constexpr int64_t kMax = std::numeric_limits<int64_t>::max();
  windows.AddLost("/a", 100, kMin, kMax, kMax);
  EXPECT_EQ(windows.Count("/a", kMax, 1), 2u);
  EXPECT_GE(windows.Count("/a", kMax, kMax), 50u);
}

TEST(CountWindowsTest, WhoMakesUpNamesCannotGrowThisNorSilenceABusyKey) {
  CountWindows windows;
  for (int i = 0; i < 100'000; ++i) {
    windows.Add("/busy", i, 1'000'000);
    windows.Add(absl::StrCat("/made_up_", i), i, 1'000'000);
    ASSERT_LE(windows.keys(), CountWindows::kKeysMax);
  }
  EXPECT_GE(windows.Count("/busy", 100'000, 1'000'000), 100'000u);
}

}  // namespace
}  // namespace rips::engine
