#include "mode_actuator/decide/degraded_status.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;
using ::testing::EndsWith;
using ::testing::IsEmpty;
using ::testing::SizeIs;

TEST(DegradedStatusTest, KeepsWhatEachSourceToldLast) {
  DegradedStatus book;
  EXPECT_THAT(book.All(), IsEmpty());
  book.Set("modes", {"a", "b"});
  book.Set("alarms", {"c"});
  EXPECT_THAT(book.All(), ElementsAre("c", "a", "b"));
  book.Set("modes", {"d"});
  book.Set("alarms", {});
  EXPECT_THAT(book.All(), ElementsAre("d"));
}

TEST(DegradedStatusTest, LimitsNumberAndLengthAndSaysSo) {
  EXPECT_THAT(LimitDegraded(std::vector<std::string>(8, "x")), SizeIs(8));
  const std::vector<std::string> cut = LimitDegraded(std::vector<std::string>(9, "x"));
  ASSERT_THAT(cut, SizeIs(8));
  EXPECT_EQ(cut[7], "and 2 more");
  EXPECT_THAT(LimitDegraded({std::string(256, 'x')})[0], SizeIs(256));
  const std::string longer = LimitDegraded({std::string(257, 'x')})[0];
  EXPECT_THAT(longer, SizeIs(256));
  EXPECT_THAT(longer, EndsWith("x..."));
  EXPECT_EQ(LimitDegraded({"\x1b[2J"})[0], "\\x1b[2J");
}

}  // namespace
}  // namespace rips::actuator
