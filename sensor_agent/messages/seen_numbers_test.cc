#include "sensor_agent/messages/seen_numbers.h"

#include <random>
#include <set>

#include "gtest/gtest.h"

namespace rips::sensor {
namespace {

TEST(SeenNumbersTest, TellsNewNumbersFromThoseThatHaveCome) {
  SeenNumbers seen;
  EXPECT_EQ(seen.highest(), 0u);
  EXPECT_FALSE(seen.Has(7));
  EXPECT_TRUE(seen.Add(7));
  EXPECT_FALSE(seen.Add(7));
  EXPECT_TRUE(seen.Add(9));
  EXPECT_FALSE(seen.Has(8));
  EXPECT_TRUE(seen.Add(UINT64_MAX));
  EXPECT_TRUE(seen.Add(8)) << "it joins two";
  EXPECT_TRUE(seen.Add(6));
  for (const uint64_t number : {6u, 7u, 8u, 9u}) EXPECT_TRUE(seen.Has(number));
  EXPECT_FALSE(seen.Has(5));
  EXPECT_FALSE(seen.Has(10));
  EXPECT_EQ(seen.highest(), UINT64_MAX);
}

// With fewer ranges than fit it is exact.
TEST(SeenNumbersTest, IsASetWhileThereIsRoom) {
  std::mt19937 random(1);
  for (int round = 0; round < 200; ++round) {
    SeenNumbers seen;
    std::set<uint64_t> model;
    for (int i = 0; i < 100; ++i) {
      const uint64_t number = 1 + random() % 30;
      ASSERT_EQ(seen.Has(number), model.contains(number));
      ASSERT_EQ(seen.Add(number), model.insert(number).second);
      ASSERT_EQ(seen.highest(), *model.rbegin());
    }
  }
}

TEST(SeenNumbersTest, WhoChoosesManyNumbersHidesNoOthers) {
  SeenNumbers seen;
  for (uint64_t number = 1; number <= 100; ++number) seen.Add(number);
  for (uint64_t i = 1; i <= 1'000; ++i) seen.Add(i * 1'000'000);
  for (uint64_t number = 101; number <= 5'000; ++number) EXPECT_FALSE(seen.Has(number));
  // Small gaps are closed: at most kSmallGap numbers beside each of its own.
  SeenNumbers close;
  for (uint64_t i = 1; i <= 1'000; ++i) close.Add(i * 10);
  EXPECT_TRUE(close.Has(15));
  EXPECT_FALSE(close.Has(10'001));
}

}  // namespace
}  // namespace rips::sensor
