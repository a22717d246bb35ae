#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/cpu_budget.h"
#include "services/base/decision_id.h"
#include "services/base/ids.h"
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

TEST(DecisionIdTest, OrdersByTermThenEpoch) {
  EXPECT_LT((DecisionId{1, 9}), (DecisionId{2, 1}));
  EXPECT_LT((DecisionId{2, 1}), (DecisionId{2, 2}));
  EXPECT_TRUE(DecisionId{}.none());
}

TEST(DecisionIdTest, ReadsBackWhatItPrints) {
  const absl::StatusOr<DecisionId> decision_id = ParseDecisionId(ToString(DecisionId{3, 17}));
  ASSERT_THAT(decision_id, IsOk());
  EXPECT_EQ(*decision_id, (DecisionId{3, 17}));
}

TEST(DecisionIdTest, RefusesWhatIsNotADecisionId) {
  for (const char* text : {"", "1", "1.", ".1", "1.2.3", "a.b", "-1.2", "1.99999999999999999999"}) {
    EXPECT_THAT(ParseDecisionId(text), StatusIs(absl::StatusCode::kInvalidArgument)) << text;
  }
}

TEST(CpuBudgetTest, SavesABurstAndFlowsInWithTime) {
  CpuBudget budget(/*per_second_ns=*/250 * kNanosPerMilli, /*burst_ns=*/500 * kNanosPerMilli, 0);
  EXPECT_FALSE(budget.Spent(0));
  budget.Charge(600 * kNanosPerMilli);
  EXPECT_TRUE(budget.Spent(0));
  EXPECT_TRUE(budget.Spent(399 * kNanosPerMilli));
  EXPECT_FALSE(budget.Spent(401 * kNanosPerMilli));
  EXPECT_FALSE(budget.Spent(1'000'000 * kNanosPerMilli));
  budget.Charge(501 * kNanosPerMilli);
  EXPECT_TRUE(budget.Spent(1'000'000 * kNanosPerMilli)) << "no more than the burst was saved";
  EXPECT_TRUE(budget.Spent(0)) << "time that goes back changes nothing";
}

}  // namespace
}  // namespace rips
