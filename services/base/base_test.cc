#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/ids.h"
#include "services/base/mark.h"
#include "services/base/status_matchers.h"

namespace rips {
namespace {

using ::testing::HasSubstr;

TEST(IdsTest, AcceptsNamesOfTheDocumentedShape) {
  EXPECT_TRUE(IsValidName("r1"));
  EXPECT_TRUE(IsValidName("a"));
  EXPECT_TRUE(IsValidName("warehouse-7"));
  EXPECT_TRUE(IsValidName(std::string(63, 'x')));
}

TEST(IdsTest, RefusesEverythingElse) {
  for (const std::string& name :
       {std::string(), std::string("-a"), std::string("a-"), std::string("R1"), std::string("a_b"),
        std::string("a/b"), std::string("a\n"), std::string(64, 'x')}) {
    EXPECT_FALSE(IsValidName(name)) << name;
  }
}

TEST(IdsTest, EscapesHostileTextInTheError) {
  EXPECT_THAT(ValidateName("robot id", "\x1b[2J"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("\\x1b[2J")));
}

TEST(IdsTest, NewIdsAre32HexDigitsAndDiffer) {
  const std::string first = NewId();
  EXPECT_EQ(first.size(), 32u);
  EXPECT_EQ(first.find_first_not_of("0123456789abcdef"), std::string::npos);
  EXPECT_NE(first, NewId());
}

TEST(MarkTest, OrdersByTermThenEpoch) {
  EXPECT_LT((Mark{1, 9}), (Mark{2, 1}));
  EXPECT_LT((Mark{2, 1}), (Mark{2, 2}));
  EXPECT_TRUE(Mark{}.none());
}

TEST(MarkTest, ReadsBackWhatItPrints) {
  const absl::StatusOr<Mark> mark = ParseMark(ToString(Mark{3, 17}));
  ASSERT_THAT(mark, IsOk());
  EXPECT_EQ(*mark, (Mark{3, 17}));
}

TEST(MarkTest, RefusesWhatIsNotAMark) {
  for (const char* text : {"", "1", "1.", ".1", "1.2.3", "a.b", "-1.2", "1.99999999999999999999"}) {
    EXPECT_THAT(ParseMark(text), StatusIs(absl::StatusCode::kInvalidArgument)) << text;
  }
}

}  // namespace
}  // namespace rips
