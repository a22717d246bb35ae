#include "sensor_agent/interest/interest.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::sensor {
namespace {

using ::testing::HasSubstr;

const std::string kId(kInterestIdBytes, 'i');

TEST(InterestTest, TheFirstMatchWins) {
  const auto interest =
      Interest::Create(kId, {{.topic_regex = "^/cam", .payload_bytes_max = 10},
                             {.topic_regex = "l$", .type = "a/msg/A", .payload_bytes_max = 20},
                             {.type = "b/msg/B", .payload_bytes_max = 30},
                             {.topic_regex = "^/quiet$"},
                             {.payload_bytes_max = 40}});
  ASSERT_THAT(interest, IsOk());
  EXPECT_EQ((*interest)->id(), kId);
  EXPECT_EQ((*interest)->Of("/camera/raw", "b/msg/B").payload_bytes, 10u);
  EXPECT_EQ((*interest)->Of("/cmd_vel", "a/msg/A").payload_bytes, 20u);
  EXPECT_EQ((*interest)->Of("/cmd_vel", "a/msg/AB").payload_bytes, 40u) << "types are exact";
  EXPECT_EQ((*interest)->Of("/x", "b/msg/B").payload_bytes, 30u);
  EXPECT_EQ((*interest)->Of("/quiet", "c/msg/C").payload_bytes, 0u) << "metadata";
  EXPECT_EQ((*interest)->Of("", "").payload_bytes, 40u);
}

TEST(InterestTest, WithoutAMatchNothingIsWanted) {
  const auto none = Interest::Create(kId, {});
  ASSERT_THAT(none, IsOk());
  EXPECT_EQ((*none)->Of("/a", "a/msg/A"), Wanted{});
  const auto one = Interest::Create(kId, {{.topic_regex = "^/a$", .payload_bytes_max = 1}});
  ASSERT_THAT(one, IsOk());
  EXPECT_EQ((*one)->Of("/a", "t"), (Wanted{.messages = true, .payload_bytes = 1}));
  EXPECT_EQ((*one)->Of("/a\n", "t"), Wanted{}) << "$ is the end of the name";
  EXPECT_EQ((*one)->Of(std::string("/a\0b", 4), "t"), Wanted{});
  EXPECT_EQ((*one)->Of("/\xff\xfe", "t"), Wanted{}) << "no UTF-8";
}

TEST(InterestTest, NothingMayBeAskedForBeforeEverything) {
  const auto interest =
      Interest::Create(kId, {{.topic_regex = "^/quiet", .payload_bytes_max = 9, .messages = false},
                             {.payload_bytes_max = 5}});
  ASSERT_THAT(interest, IsOk());
  EXPECT_EQ((*interest)->Of("/quiet/x", "t"), Wanted{});
  EXPECT_EQ((*interest)->Of("/loud", "t"), (Wanted{.messages = true, .payload_bytes = 5}));
}

TEST(InterestTest, LiteralNamesAreRecognised) {
  const std::vector<std::pair<std::string, std::vector<std::string>>> cases = {
      {"^/rosout$", {"/rosout"}},
      {"^\\/parameter_events$", {"/parameter_events"}},
      {absl::StrCat("^", RE2::QuoteMeta("/a/b_c1"), "$"), {"/a/b_c1"}},
      {"^(?:/a|\\/b)$", {"/a", "/b"}},
      {"^(?:/a)$", {"/a"}},
      // May match more than it names, or is not written as a name.
      {"", {}},
      {"/rosout", {}},
      {"^/rosout", {}},
      {"/rosout$", {}},
      {"^/ro.out$", {}},
      {"^/(rosout|a)$", {}},
      {"^/a|/rosout$", {}},
      {"^/rosou[t]$", {}},
      {"^/rosout\\$", {}},
      {"^/ros\\out$", {}},
      {"^(?:/a|/b$", {}},
      {"^(?:)$", {}},
      {"^(?:/a|.*)$", {}},
      {"^$", {}},
      {"^rosout$", {}},
      {"^/a\\|/b$", {}},
      {"(?i)^/rosout$", {}}};
  for (const auto& [regex, names] : cases) EXPECT_EQ(LiteralTopics(regex), names) << regex;
}

TEST(WatchPlanTest, UnwatchedTopicsAreReadOnlyIfARuleNamesThem) {
  const auto plan = [](std::vector<InterestRule> rules) {
    return WatchPlan(
        {.unwatched = {"/rosout"}, .interest = *Interest::Create(kId, std::move(rules))});
  };
  const WatchPlan none({.unwatched = {"/rosout"}});
  EXPECT_FALSE(none.Of("/rosout", "t").messages);
  EXPECT_EQ(none.Of("/a", "t"), Wanted{.messages = true}) << "metadata of everything else";
  EXPECT_FALSE(plan({{}}).Of("/rosout", "t").messages);
  EXPECT_FALSE(plan({{.topic_regex = "rosout"}}).Of("/rosout", "t").messages);
  EXPECT_TRUE(plan({{.topic_regex = "^/rosout$"}}).Of("/rosout", "t").messages);
  // Once it is named the table alone decides.
  const auto named = plan({{.topic_regex = "out", .payload_bytes_max = 7},
                           {.topic_regex = "^/rosout$", .type = "other"}});
  EXPECT_EQ(named.Of("/rosout", "t"), (Wanted{.messages = true, .payload_bytes = 7}));
  EXPECT_FALSE(
      plan({{.topic_regex = "^/rosout$", .messages = false}, {}}).Of("/rosout", "t").messages);
}

TEST(WatchPlanTest, AnIdleHostReadsNothing) {
  const WatchPlan plan({.idle = true});
  EXPECT_EQ(plan.Of("/a", "t"), Wanted{});
}

TEST(WatchPlanTest, AnswersStayTheSameWhenMoreAreAskedThanRemembered) {
  const WatchPlan plan(
      {.interest = *Interest::Create(kId, {{.topic_regex = "7$", .payload_bytes_max = 3}})});
  for (int round = 0; round < 2; ++round) {
    for (size_t i = 0; i < kWatchAnswersMax + 20; ++i) {
      ASSERT_EQ(plan.Of(absl::StrCat("/t", i), "t").messages, i % 10 == 7) << i;
    }
  }
}

TEST(InterestTest, NoRuleGetsMoreThanTheLimit) {
  const auto interest = Interest::Create(kId, {{.payload_bytes_max = UINT32_MAX}});
  ASSERT_THAT(interest, IsOk());
  EXPECT_EQ((*interest)->Of("/a", "").payload_bytes, kPayloadBytesHard);
}

TEST(InterestTest, TheFirstPayloadLimitThatMatchesCountsForTopicsWithAPayload) {
  const auto interest = Interest::Create(kId,
                                         {{.topic_regex = "^/meta$"},
                                          {.topic_regex = "^/none$", .messages = false},
                                          {.payload_bytes_max = 1'000}},
                                         {{.topic_regex = "^/camera/", .bytes = 2'000},
                                          {.topic_regex = "raw", .bytes = 10},
                                          {.topic_regex = "huge", .bytes = UINT32_MAX}});
  ASSERT_THAT(interest, IsOk());
  const auto bytes = [&](const char* topic) { return (*interest)->Of(topic, "t").payload_bytes; };
  EXPECT_EQ(bytes("/camera/raw"), 2'000u);
  EXPECT_EQ(bytes("/raw"), 10u);
  EXPECT_EQ(bytes("/scan"), 1'000u) << "as the rule says";
  EXPECT_EQ(bytes("/huge"), kPayloadBytesHard);
  EXPECT_EQ(bytes("/meta"), 0u);
  EXPECT_EQ((*interest)->Of("/none", "t"), Wanted{});

  EXPECT_THAT(Interest::Create(kId, {}, {{.topic_regex = "a"}, {.topic_regex = "("}}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("payload limit 2: bad pattern: RE2 error 6")));
  EXPECT_THAT(Interest::Create(kId, {}, std::vector<PayloadLimit>(kPayloadLimitsMax + 1)),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("65 payload limits exceed the limit of 64")));
}

TEST(InterestTest, RefusesWhatItCannotHold) {
  const auto invalid = absl::StatusCode::kInvalidArgument;
  const auto exhausted = absl::StatusCode::kResourceExhausted;
  EXPECT_THAT(Interest::Create("short", {}), StatusIs(invalid, HasSubstr("5 bytes, not 32")));
  EXPECT_THAT(Interest::Create(kId, {{.topic_regex = "a"}, {.topic_regex = "("}}),
              StatusIs(invalid, HasSubstr("rule 2: bad pattern: RE2 error 6")));
  EXPECT_THAT(Interest::Create(kId, {{.topic_regex = "\xff"}}),
              StatusIs(invalid, HasSubstr("RE2 error 13")));

  EXPECT_THAT(Interest::Create(kId, std::vector<InterestRule>(kInterestRulesMax)), IsOk());
  EXPECT_THAT(Interest::Create(kId, std::vector<InterestRule>(kInterestRulesMax + 1)),
              StatusIs(exhausted, HasSubstr("1025 rules exceed the limit of 1024")));

  EXPECT_THAT(Interest::Create(kId, {{.topic_regex = "((x{100}){100}){100}"}}),
              StatusIs(invalid, HasSubstr("rule 1")));
  EXPECT_THAT(Interest::Create(kId, {{.topic_regex = "(\\pL\\pN\\pS){300}"}}),
              StatusIs(exhausted, HasSubstr("rule 1: the pattern needs more than 1048576 bytes")));
}

TEST(InterestTest, PatternsTogetherAreBounded) {
  // Larger than what is tried first, and yet no limit by itself.
  const std::string large = "(abcdefgh|ijklmnop){900}";
  ASSERT_THAT(Interest::Create(kId, {{.topic_regex = large}}), IsOk());
  std::vector<InterestRule> rules;
  for (int i = 0; i < 100; ++i) rules.push_back({.topic_regex = absl::StrCat(large, i)});
  EXPECT_THAT(Interest::Create(kId, rules),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("exceed the limit of 200000 instructions")));
}

}  // namespace
}  // namespace rips::sensor
