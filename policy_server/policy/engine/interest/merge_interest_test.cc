#include "policy_server/policy/engine/interest/merge_interest.h"

#include <random>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "services/base/payload_limits.h"
#include "services/base/test_rounds.h"

namespace rips::engine {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::SizeIs;

TopicInterest RowOf(std::string regex, Depth depth, uint32_t bytes = 0,
                    std::vector<std::string> wanted_by = {}) {
  return {.topic_regex = std::move(regex),
          .depth = depth,
          .payload_bytes_max = bytes,
          .wanted_by = std::move(wanted_by)};
}
constexpr Depth kNo = Depth::kNothing;
constexpr Depth kMeta = Depth::kMetadata;
constexpr Depth kFull = Depth::kPayload;

TEST(InterestReaderTest, TheFirstMatchOfThePlanAndOfTheLimitsCounts) {
  InterestReader reader({.plan = {RowOf("^/a$", kNo), RowOf("^/cam", kFull, 100), RowOf("", kMeta)},
                         .limits = {{"raw$", 7}, {"", 9}}});
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(reader.Of("/a"), (Need{kNo, 0}));
    EXPECT_EQ(reader.Of("/cam/raw"), (Need{kFull, 7}));
    EXPECT_EQ(reader.Of("/cam"), (Need{kFull, 9}));
    EXPECT_EQ(reader.Of("/other"), (Need{kMeta, 0}));
  }
  for (size_t i = 0; i < 2 * InterestReader::kTopicsMax; ++i) {
    ASSERT_EQ(reader.Of(absl::StrCat("/made/up", i)).depth, kMeta);
  }
  EXPECT_EQ(InterestReader({}).Of("/a"), Need{});
  EXPECT_EQ(InterestReader({.plan = {RowOf("(", kMeta)}, .limits = {}}).Of("/a").depth, kMeta);
}

TEST(MergeInterestTest, NamesKeepTheirExceptions) {
  const Interest merged = MergeInterest(
      {.plan = {RowOf("^/rosout$", kNo), RowOf("^/a$", kFull, 10, {"r1"}), RowOf("", kMeta)},
       .limits = {}},
      {.plan = {RowOf("^/rosout$", kNo), RowOf("^/a$", kMeta, 0, {"r2"}), RowOf("", kNo)},
       .limits = {}});
  EXPECT_THAT(merged.plan, ElementsAre(RowOf("^/rosout$", kNo),
                                       RowOf("^/a$", kFull, 10, {"r1", "r2"}), RowOf("", kMeta)));
}

TEST(MergeInterestTest, ANameStaysWhereAPatternAsksForAsMuch) {
  const Interest merged =
      MergeInterest({.plan = {RowOf("^/unwatched$", kMeta), RowOf("", kNo)}, .limits = {}},
                    {.plan = {RowOf("", kMeta)}, .limits = {}});
  EXPECT_THAT(merged.plan, Contains(RowOf("^/unwatched$", kMeta)));
}

TEST(MergeInterestTest, TheSameTwiceIsThatPlan) {
  const Interest one{.plan = {RowOf("^/a$", kMeta), RowOf("^/cam", kFull, 10), RowOf("", kNo)},
                     .limits = {{"^/cam", 5}, {"^/a", 7}}};
  EXPECT_EQ(MergeInterest(one, one), one);
}

TEST(MergeInterestTest, ALimitOfOneDoesNotCutWhatTheOtherAsksFor) {
  const Interest merged =
      MergeInterest({.plan = {RowOf("", kFull, 1'000)}, .limits = {{"^/cam$", 10}, {"^/c", 20}}},
                    {.plan = {RowOf("^/cam$", kFull, 500), RowOf("", kNo)}, .limits = {}});
  InterestReader reader(merged);
  EXPECT_EQ(reader.Of("/cam").payload_bytes, 500u);
  EXPECT_EQ(reader.Of("/other").payload_bytes, 1'000u);
  EXPECT_GE(reader.Of("/cloud").payload_bytes, 20u);
}

// Patterns as PlanInterest makes them, and some that it does not.
Interest RandomInterest(std::mt19937& random) {
  const auto pick = [&](size_t n) { return random() % n; };
  const std::vector<std::string> regexes = {
      "^/a$",  "^/b$", "^/cam/a$", "^/cam/b$", "^/we\\.ird$", "^/b.$", "^\\/b$",
      "^/cam", "a$",   "b",        "^/x",      "^/a|b$",      ""};
  const auto bytes = [&] { return static_cast<uint32_t>(1 + pick(6)) * 1'000; };
  Interest interest;
  for (size_t i = pick(7); i > 0; --i) {
    const Depth depth = std::vector<Depth>{kNo, kMeta, kFull}[pick(3)];
    interest.plan.push_back(
        RowOf(regexes[pick(regexes.size())], depth, depth == kFull ? bytes() : 0));
  }
  const Depth depth = std::vector<Depth>{kNo, kNo, kMeta, kFull}[pick(4)];
  interest.plan.push_back(RowOf("", depth, depth == kFull ? bytes() : 0));
  for (size_t i = pick(4); i > 0; --i) {
    interest.limits.push_back({regexes[pick(regexes.size())], bytes()});
  }
  return interest;
}

TEST(MergeInterestTest, OfEveryTopicAtLeastWhatEachAsksForAlone) {
  const std::vector<std::string> topics = {"/a",      "/b",      "/cam/a", "/cam/b", "/cam/c",
                                           "/we.ird", "/weXird", "/x/a",   "/other", "/ba"};
  std::mt19937 random(7);
  for (int round = 0; round < Rounds(3'000); ++round) {
    const Interest a = RandomInterest(random);
    Interest b = RandomInterest(random);
    if (round % 3 == 0) b.limits = a.limits;
    const Interest merged = MergeInterest(a, b);
    InterestReader of_a(a), of_b(b), of_merged(merged);
    for (const std::string& topic : topics) {
      const Need need = of_merged.Of(topic);
      for (const Need& least : {of_a.Of(topic), of_b.Of(topic)}) {
        ASSERT_GE(need.depth, least.depth) << round << " " << topic;
        ASSERT_GE(need.payload_bytes, least.payload_bytes) << round << " " << topic;
      }
    }
    ASSERT_TRUE(merged.plan.back().topic_regex.empty());
  }
}

TEST(MergeInterestTest, TwoPlansAtTheirLimitFitWithoutAskingForMore) {
  Interest a, b;
  for (size_t i = 0; i + 1 < kInterestsMax; ++i) {
    a.plan.push_back(RowOf(absl::StrCat("^/a", i, "$"), kMeta));
    b.plan.push_back(RowOf(absl::StrCat("^/b", i, "$"), kFull, 5));
  }
  a.plan.push_back(RowOf("", kNo));
  b.plan.push_back(RowOf("", kNo));
  const Interest merged = MergeInterest(a, b);
  EXPECT_THAT(merged.plan, SizeIs(2 * kInterestsMax - 1));
  EXPECT_EQ(InterestReader(merged).Of("/other").depth, kNo);
}

TEST(MergeInterestTest, PastALimitMoreIsAskedForAndNamesOfTheFirstStay) {
  Interest a, b;
  for (size_t i = 0; i < 3; ++i) a.plan.push_back(RowOf(absl::StrCat("^/a", i, "$"), kMeta));
  for (size_t i = 0; i < 30; ++i) {
    b.plan.push_back(RowOf(absl::StrCat("/b", i, std::string(5'000, 'b')), kFull, 5));
  }
  b.limits = {{"^/b", 50}};
  const Interest merged = MergeInterest(a, b);
  EXPECT_THAT(merged.plan, SizeIs(4));
  EXPECT_THAT(merged.plan, Contains(Field(&TopicInterest::topic_regex, "^/a2$")));
  EXPECT_THAT(merged.limits, SizeIs(0));
  InterestReader reader(merged);
  EXPECT_LE(reader.instructions(), kInterestInstructionsMax);
  EXPECT_EQ(reader.Of("/anything"), (Need{kFull, 50}));

  Interest limited_a{.plan = {RowOf("", kFull, 9)}, .limits = {}};
  Interest limited_b = limited_a;
  for (size_t i = 0; i < kPayloadLimitsMax; ++i) {
    limited_a.limits.push_back({absl::StrCat("^/a", i), 20});
    limited_b.limits.push_back({absl::StrCat("^/b", i), 30});
  }
  const Interest limits = MergeInterest(limited_a, limited_b);
  EXPECT_THAT(limits.limits, SizeIs(0));
  EXPECT_EQ(InterestReader(limits).Of("/a1"), (Need{kFull, 30}));
}

TEST(MergeKeptTopicsTest, TheFirstComeFirstUpToTheLimit) {
  ros2::TopicNames first, second = {"/x", "/y"};
  for (size_t i = 0; i + 1 < ros2::kKeptTopicsMax; ++i) first.insert(absl::StrCat("/t", i));
  const ros2::TopicNames merged = MergeKeptTopics(first, second);
  EXPECT_THAT(merged, SizeIs(ros2::kKeptTopicsMax));
  EXPECT_TRUE(merged.contains("/t0") && merged.contains("/x") && !merged.contains("/y"));
}

}  // namespace
}  // namespace rips::engine
