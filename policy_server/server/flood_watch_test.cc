#include "policy_server/server/flood_watch.h"

#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips {
namespace {

using ::testing::SizeIs;

using Kind = FloodWatch::Report::Kind;
using Report = FloodWatch::Report;

class FloodWatchTest : public ::testing::Test {
 protected:
  void Seconds(double seconds) { now_ns_ += static_cast<int64_t>(seconds * kNanosPerSecond); }
  // Those that the counts made due.
  std::vector<Report> Count(const std::string& source, int times = 1) {
    std::vector<Report> reports;
    for (int i = 0; i < times; ++i) {
      if (auto report = watch_.Count({.source = source}, now_ns_)) reports.push_back(*report);
    }
    return reports;
  }
  std::optional<Report> Poll() { return watch_.Poll(now_ns_); }
  // The end of this minute.
  std::optional<Report> NextMinute() {
    now_ns_ = minute_ns_ += FloodWatch::kMinuteNs;
    return Poll();
  }
  void SetUp() override { EXPECT_FALSE(Poll()); }

  int64_t now_ns_ = 1'000 * kNanosPerSecond;
  int64_t minute_ns_ = now_ns_;
  FloodWatch watch_{{.of_source = 5, .of_all = 20, .named = 3}};
};

TEST_F(FloodWatchTest, ASourceIsReportedAtItsLimit) {
  EXPECT_THAT(Count("10.0.0.1", 4), SizeIs(0));
  Seconds(3);
  const auto reports = Count("10.0.0.1");
  ASSERT_THAT(reports, SizeIs(1));
  EXPECT_EQ(reports[0].kind, Kind::kSource);
  EXPECT_EQ(reports[0].most[0].source, "10.0.0.1");
  EXPECT_EQ(reports[0].count, 5u);
  EXPECT_EQ(reports[0].within_ns, 3 * kNanosPerSecond);
}

TEST_F(FloodWatchTest, WhoComesNowAndThenIsNotReported) {
  for (int i = 0; i < 500; ++i) {
    EXPECT_THAT(Count("10.0.0.1", 2), SizeIs(0));
    Seconds(7);
    EXPECT_FALSE(Poll());
  }
}

TEST_F(FloodWatchTest, TheEndOfAWindowStartsNoCountAnew) {
  EXPECT_THAT(Count("10.0.0.1"), SizeIs(0));
  Seconds(9);
  EXPECT_THAT(Count("10.0.0.1", 3), SizeIs(0));
  Seconds(1.1);
  EXPECT_THAT(Count("10.0.0.1", 3), SizeIs(1)) << "six within 1.1 s";
}

TEST_F(FloodWatchTest, AMinuteOfAFloodIsReportedWhenItHasPassedUntilItStops) {
  for (int i = 0; i < 6; ++i) {
    EXPECT_THAT(Count("10.0.0.1", 100), SizeIs(i == 0 ? 1 : 0));
    Seconds(10.5);
  }
  auto report = NextMinute();
  ASSERT_TRUE(report);
  EXPECT_EQ(report->kind, Kind::kMinute);
  EXPECT_EQ(report->count, 600u);
  EXPECT_EQ(report->sources, 1u);
  EXPECT_TRUE(report->goes_on);
  EXPECT_THAT(Count("10.0.0.1", 100), SizeIs(0)) << "it has been reported by itself";
  report = NextMinute();
  ASSERT_TRUE(report);
  EXPECT_EQ(report->count, 100u);
  EXPECT_FALSE(report->goes_on);
  EXPECT_THAT(Count("10.0.0.1", 4), SizeIs(0));
  report = NextMinute();
  ASSERT_TRUE(report) << "that it is over is reported, too";
  EXPECT_EQ(report->kind, Kind::kOver);
  EXPECT_EQ(report->count, 4u);
  EXPECT_FALSE(NextMinute());
}

TEST_F(FloodWatchTest, ASourceIsReportedByItselfAgainAfterTenMinutes) {
  EXPECT_THAT(Count("10.0.0.1", 100), SizeIs(1));
  for (int i = 0; i < 9; ++i) {
    NextMinute();
    EXPECT_THAT(Count("10.0.0.1", 100), SizeIs(0));
  }
  NextMinute();
  EXPECT_THAT(Count("10.0.0.1", 100), SizeIs(1));
}

TEST_F(FloodWatchTest, ManyQuietSourcesAreReportedTogether) {
  for (int i = 0; i < 19; ++i) EXPECT_THAT(Count(absl::StrCat("10.0.0.", i)), SizeIs(0));
  const auto reports = Count("10.0.0.19");
  ASSERT_THAT(reports, SizeIs(1));
  EXPECT_EQ(reports[0].kind, Kind::kAll);
  EXPECT_EQ(reports[0].count, 20u);
  EXPECT_EQ(reports[0].sources, 20u);
  EXPECT_THAT(reports[0].most, SizeIs(FloodWatch::kMostMax));
  EXPECT_THAT(Count("10.0.0.20", 4), SizeIs(0));
  EXPECT_TRUE(NextMinute());
}

TEST_F(FloodWatchTest, ALoudSourceIsNotCountedWithTheQuietOnes) {
  EXPECT_THAT(Count("10.0.0.1", 1'000), SizeIs(1));
  for (int i = 0; i < 19; ++i) EXPECT_THAT(Count(absl::StrCat("10.0.1.", i)), SizeIs(0));
  EXPECT_THAT(Count("10.0.1.19"), SizeIs(1));
}

// Decoys use up the names and the report of all; then the real one begins, and pauses at the end.
TEST_F(FloodWatchTest, DecoysHideNoSourceFromTheMinutesReport) {
  for (int minute = 0; minute < 5; ++minute) {
    for (int i = 0; i < 40; ++i) Count(absl::StrCat("10.1.", minute, ".", i), 6);
    Seconds(2);
    EXPECT_THAT(Count("10.9.9.9", 1'000), SizeIs(0));
    const auto report = NextMinute();
    ASSERT_TRUE(report);
    EXPECT_EQ(report->most[0].source, "10.9.9.9");
    EXPECT_EQ(report->most[0].count, 1'000u);
    EXPECT_EQ(report->count, 1'240u);
    EXPECT_EQ(report->sources, 41u);
  }
}

TEST_F(FloodWatchTest, OnlySoManyAreReportedByThemselves) {
  size_t named = 0;
  for (int i = 0; i < 40; ++i) {
    for (const Report& report : Count(absl::StrCat("10.0.0.", i), 10)) {
      named += report.kind == Kind::kSource ? 1 : 0;
    }
  }
  EXPECT_EQ(named, 3u);
  EXPECT_TRUE(NextMinute());
  EXPECT_THAT(Count("10.0.1.1", 10), SizeIs(1)) << "one more each minute";
  EXPECT_THAT(Count("10.0.1.2", 10), SizeIs(0));
}

TEST_F(FloodWatchTest, ASourceOfManyIsFoundAmongMoreThanAreToldApart) {
  for (int i = 0; i < 100'000; ++i) {
    Count(absl::StrCat("2001:db8::", i));
    if (i > 50'000 && i % 10 == 0) Count("10.9.9.9");
  }
  const auto report = NextMinute();
  ASSERT_TRUE(report);
  EXPECT_FALSE(report->counted);
  EXPECT_EQ(report->sources, FloodWatch::kSourcesMax);
  EXPECT_EQ(report->most[0].source, "10.9.9.9");
  EXPECT_GT(report->most[0].count, 4'900u);
  EXPECT_GT(report->count, 104'000u);
}

TEST_F(FloodWatchTest, TheCountOfEachRankAndTheNewestDetailAreReported) {
  watch_.Count({.source = "a", .rank = 1, .detail = "first"}, now_ns_);
  watch_.Count({.source = "a", .rank = 3, .detail = "second"}, now_ns_);
  for (int i = 0; i < 3; ++i) {
    const auto report = watch_.Count({.source = "a", .rank = 1, .detail = "last"}, now_ns_);
    ASSERT_EQ(report.has_value(), i == 2);
    if (!report) continue;
    EXPECT_EQ(report->most[0].by_rank[3], 1u);
    EXPECT_EQ(report->most[0].rank, 0) << "one says little";
    EXPECT_EQ(report->most[0].by_rank[1], 4u);
    EXPECT_EQ(report->most[0].detail, "last");
  }
}

// A key that was reported for something harmless, and then does worse.
TEST_F(FloodWatchTest, AHigherRankIsReportedAgainAtOnce) {
  FloodWatch watch({.of_source = 5, .of_all = 1'000, .gravest_first = true});
  const auto count = [&](const std::string& source, int rank, int times) {
    int reports = 0;
    for (int i = 0; i < times; ++i) {
      reports += watch.Count({.source = source, .rank = rank}, now_ns_).has_value() ? 1 : 0;
    }
    return reports;
  };
  EXPECT_EQ(count("mallory", 2, 1), 0);
  EXPECT_EQ(count("mallory", 0, 50), 1);
  EXPECT_EQ(count("mallory", 2, 3), 0) << "now and then";
  EXPECT_EQ(count("mallory", 2, 50), 1);
  EXPECT_EQ(count("mallory", 2, 50), 0);
  EXPECT_EQ(count("mallory", 1, 50), 0) << "no worse";
  for (int i = 0; i < 20; ++i) count(absl::StrCat("robot ", i), 1, 500);
  for (int i = 0; i < 20; ++i) count(absl::StrCat("dashboard ", i), 3, 1);
  now_ns_ += FloodWatch::kMinuteNs;
  const auto report = watch.Poll(now_ns_);
  ASSERT_TRUE(report);
  EXPECT_EQ(report->most[0].source, "mallory") << "the gravest first";
  EXPECT_EQ(report->most[0].by_rank[2], 104u);
}

}  // namespace
}  // namespace rips
