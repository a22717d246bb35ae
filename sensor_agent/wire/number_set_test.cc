#include "sensor_agent/wire/number_set.h"

#include <cstdint>
#include <random>
#include <set>

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::wire {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::UnorderedElementsAre;

TEST(NumberSetTest, NumbersInARowAreOneRun) {
  NumberSet set(4);
  for (const uint64_t number : {7, 8, 8, 7, 9, 10, 6}) EXPECT_TRUE(set.Add(number));

  EXPECT_THAT(set.runs(), ElementsAre(NumberRun{6, 10}));
  EXPECT_EQ(set.count(), 5);
}

TEST(NumberSetTest, ANumberBetweenTwoRunsMakesThemOne) {
  NumberSet set(4);
  for (const uint64_t number : {1, 3, 20, 2}) set.Add(number);

  EXPECT_THAT(set.runs(), UnorderedElementsAre(NumberRun{1, 3}, NumberRun{20, 20}));
}

TEST(NumberSetTest, ARunMayTakeInSeveral) {
  NumberSet set(4);
  for (const uint64_t number : {1, 10, 20}) set.Add(number);
  set.Add(NumberRun{2, 30});

  EXPECT_THAT(set.runs(), ElementsAre(NumberRun{1, 30}));
  EXPECT_TRUE(set.Add(NumberRun{9, 8}));  // empty
  EXPECT_EQ(set.count(), 30);
}

TEST(NumberSetTest, BeyondTheLimitTheRunThatIsOutOfUseIsForgotten) {
  NumberSet set(2);
  set.Add(1);
  set.Add(1'000);
  set.Add(2);
  set.Add(uint64_t{1} << 40);

  EXPECT_THAT(set.runs(),
              ElementsAre(NumberRun{1, 2}, NumberRun{uint64_t{1} << 40, uint64_t{1} << 40}));
}

TEST(NumberSetTest, OrTheNewNumberIsLeftOut) {
  NumberSet set(2, /*keep=*/true);
  set.Add(1);
  set.Add(10);

  EXPECT_EQ(set.overflows(), 0);
  EXPECT_FALSE(set.Add(20));
  EXPECT_EQ(set.overflows(), 1);
  EXPECT_TRUE(set.Add(10));
  EXPECT_TRUE(set.Add(2));
  EXPECT_EQ(set.count(), 3);
}

TEST(NumberSetTest, CountsWhatTwoHaveInCommon) {
  NumberSet set(4);
  set.Add(NumberRun{10, 19});
  set.Add(NumberRun{30, 39});

  EXPECT_EQ(set.CountIn({1, 9}), 0);
  EXPECT_EQ(set.CountIn({15, 34}), 10);
  EXPECT_EQ(set.CountIn({0, 100}), 20);
}

TEST(NumberSetTest, TellsWhatItHasNot) {
  NumberSet set(4);
  set.Add(NumberRun{30, 39});
  set.Add(NumberRun{10, 19});

  EXPECT_THAT(set.Without({1, 50}),
              ElementsAre(NumberRun{1, 9}, NumberRun{20, 29}, NumberRun{40, 50}));
  EXPECT_THAT(set.Without({12, 35}), ElementsAre(NumberRun{20, 29}));
  EXPECT_THAT(set.Without({31, 32}), IsEmpty());
  EXPECT_THAT(set.Without({1, 2}), ElementsAre(NumberRun{1, 2}));
}

TEST(NumberSetTest, IsASetOfNumbers) {
  std::mt19937 random(1);  // NOLINT: the same numbers each time
  for (int round = 0; round < 20; ++round) {
    NumberSet set(64);
    std::set<uint64_t> numbers;
    for (int i = 0; i < 50; ++i) {
      const uint64_t number = 1 + random() % 60;
      set.Add(number);
      numbers.insert(number);
      ASSERT_EQ(set.count(), numbers.size());
      ASSERT_EQ(set.CountIn({20, 40}),
                std::distance(numbers.lower_bound(20), numbers.upper_bound(40)));
    }
  }
}

}  // namespace
}  // namespace rips::wire
