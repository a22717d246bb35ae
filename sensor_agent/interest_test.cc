#include "sensor_agent/interest.h"

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
  EXPECT_EQ((*interest)->PayloadBytes("/camera/raw", "b/msg/B"), 10u);
  EXPECT_EQ((*interest)->PayloadBytes("/cmd_vel", "a/msg/A"), 20u);
  EXPECT_EQ((*interest)->PayloadBytes("/cmd_vel", "a/msg/AB"), 40u) << "types are exact";
  EXPECT_EQ((*interest)->PayloadBytes("/x", "b/msg/B"), 30u);
  EXPECT_EQ((*interest)->PayloadBytes("/quiet", "c/msg/C"), 0u) << "metadata";
  EXPECT_EQ((*interest)->PayloadBytes("", ""), 40u);
}

TEST(InterestTest, WithoutAMatchMetadataIsEnough) {
  const auto none = Interest::Create(kId, {});
  ASSERT_THAT(none, IsOk());
  EXPECT_EQ((*none)->PayloadBytes("/a", "a/msg/A"), 0u);
  const auto one = Interest::Create(kId, {{.topic_regex = "^/a$", .payload_bytes_max = 1}});
  ASSERT_THAT(one, IsOk());
  EXPECT_EQ((*one)->PayloadBytes("/a\n", "t"), 0u) << "$ is the end of the name";
  EXPECT_EQ((*one)->PayloadBytes(std::string("/a\0b", 4), "t"), 0u);
  EXPECT_EQ((*one)->PayloadBytes("/\xff\xfe", "t"), 0u) << "no UTF-8";
}

TEST(InterestTest, NoRuleGetsMoreThanTheLimit) {
  const auto interest = Interest::Create(kId, {{.payload_bytes_max = UINT32_MAX}});
  ASSERT_THAT(interest, IsOk());
  EXPECT_EQ((*interest)->PayloadBytes("/a", ""), kPayloadBytesMax);
}

TEST(InterestTest, RefusesWhatItCannotHold) {
  const auto invalid = absl::StatusCode::kInvalidArgument;
  const auto exhausted = absl::StatusCode::kResourceExhausted;
  EXPECT_THAT(Interest::Create("short", {}), StatusIs(invalid, HasSubstr("5 bytes, not 32")));
  EXPECT_THAT(Interest::Create(kId, {{.topic_regex = "a"}, {.topic_regex = "("}}),
              StatusIs(invalid, HasSubstr("rule 2: bad pattern: missing )")));
  EXPECT_THAT(Interest::Create(kId, {{.topic_regex = "\xff"}}),
              StatusIs(invalid, HasSubstr("invalid UTF-8")));

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
