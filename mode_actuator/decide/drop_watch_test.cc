#include "mode_actuator/decide/drop_watch.h"

#include <cstdint>
#include <limits>
#include <optional>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/clock.h"

namespace rips::actuator {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

constexpr int64_t kSecond = kNanosPerSecond;

model::FirewallDrops Drops(uint64_t packets, uint32_t counted_s, uint32_t quiet_s) {
  return {.packets = packets, .counted_s = counted_s, .quiet_s = quiet_s};
}

TEST(DropWatchTest, SaysNothingOfALevelWithoutAFirewall) {
  EXPECT_EQ(DropWatch().Report(5 * kSecond), std::nullopt);
}

TEST(DropWatchTest, CountsSinceTheLevelWasEntered) {
  DropWatch watch;
  watch.Enter(9 * kSecond);
  EXPECT_EQ(watch.Report(10 * kSecond), std::nullopt);
  watch.Saw({5000}, 10 * kSecond);
  EXPECT_EQ(watch.Report(12 * kSecond), Drops(0, 3, 2)) << "of the level before, for all we know";
  watch.Saw({5007}, 13 * kSecond);
  EXPECT_EQ(watch.Report(13 * kSecond), Drops(7, 4, 0));
  watch.Saw({5007}, 15 * kSecond);
  watch.Saw({5007}, 17 * kSecond);
  EXPECT_EQ(watch.Report(18 * kSecond), Drops(7, 9, 5));
}

TEST(DropWatchTest, WhatWasDroppedBeforeTheFirstLookIsTheSources) {
  DropWatch watch;
  watch.Enter(10 * kSecond);
  watch.Saw({5000, {{"10.0.0.66", 180, 0}, {"10.0.0.13", 5, 1}}, 0}, 14 * kSecond);
  EXPECT_EQ(watch.Report(14 * kSecond)->packets, 185u);
  EXPECT_EQ(watch.Report(14 * kSecond)->counted_s, 4u);
  EXPECT_EQ(watch.Report(14 * kSecond)->quiet_s, 0u);
  watch.Saw({5010, {{"10.0.0.66", 190, 0}, {"10.0.0.13", 5, 5}}, 0}, 18 * kSecond);
  EXPECT_EQ(watch.Report(18 * kSecond)->packets, 195u);
  watch.Enter(20 * kSecond);
  watch.Saw({3, {{"10.0.0.66", 180, 0}}, 0}, 21 * kSecond);
  EXPECT_EQ(watch.Report(21 * kSecond)->packets, 3u) << "never more than the table's counter";
}

TEST(DropWatchTest, ATableThatWasMadeAnewCountsFromZero) {
  DropWatch watch;
  watch.Saw({100}, 0);
  watch.Saw({110}, kSecond);
  watch.Saw({3}, 2 * kSecond);
  EXPECT_EQ(watch.Report(2 * kSecond), Drops(13, 2, 0));
  watch.Saw({0}, 3 * kSecond);
  EXPECT_EQ(watch.Report(3 * kSecond), Drops(13, 3, 0));
}

TEST(DropWatchTest, ALevelThatIsEnteredBeginsAnew) {
  DropWatch watch;
  watch.Saw({1}, 0);
  watch.Saw({9}, kSecond);
  watch.Enter(2 * kSecond);
  EXPECT_EQ(watch.Report(2 * kSecond), std::nullopt);
  watch.Saw({9}, 3 * kSecond);
  EXPECT_EQ(watch.Report(4 * kSecond), Drops(0, 2, 1));
}

TEST(DropWatchTest, SourcesGrowOlderUntilTheNextLook) {
  DropWatch watch;
  watch.Saw({7, {{"10.0.0.66", 5, 3}, {"10.0.0.13", 2, 60}}, 4}, 0);
  const std::optional<model::FirewallDrops> drops = watch.Report(2 * kSecond);
  ASSERT_TRUE(drops.has_value());
  EXPECT_THAT(drops->sources, ElementsAre(model::DropSource{"10.0.0.66", 5, 5},
                                          model::DropSource{"10.0.0.13", 2, 62}));
  EXPECT_EQ(drops->more_sources, 4u);
  watch.Saw({7, {}, 0}, 3 * kSecond);
  EXPECT_THAT(watch.Report(3 * kSecond)->sources, IsEmpty()) << "forgotten by the kernel";
  watch.Saw({8, {{"10.0.0.66", 1, UINT32_MAX}}, 0}, 4 * kSecond);
  EXPECT_EQ(watch.Report(9 * kSecond)->sources[0].quiet_s, UINT32_MAX);
  watch.Enter(10 * kSecond);
  watch.Saw({8, {}, 0}, 10 * kSecond);
  EXPECT_EQ(watch.Report(11 * kSecond), Drops(0, 1, 1));
}

TEST(DropWatchTest, TimesStayInTheirRange) {
  DropWatch watch;
  watch.Saw({0}, 0);
  EXPECT_EQ(watch.Report(-kSecond), Drops(0, 0, 0));
  EXPECT_EQ(watch.Report(std::numeric_limits<int64_t>::max())->quiet_s, 4294967295u);
}

}  // namespace
}  // namespace rips::actuator
