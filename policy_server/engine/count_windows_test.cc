#include "policy_server/engine/count_windows.h"

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
