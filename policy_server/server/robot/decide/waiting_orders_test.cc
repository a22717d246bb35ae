#include "policy_server/server/robot/decide/waiting_orders.h"

#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::pipeline {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

class WaitingOrdersTest : public ::testing::Test {
 protected:
  void Wait(uint64_t epoch, const std::string& request_id) {
    orders_.Wait(At(epoch), request_id, {.token = epoch, .answer = {.decided_level = request_id}});
  }
  static DecisionId At(uint64_t epoch) { return {.term = 1, .epoch = epoch}; }

  void Keep(const std::optional<action::AnswerOrder>& answer) {
    if (answer) Keep(std::vector<action::AnswerOrder>{*answer});
  }
  void Keep(const std::vector<action::AnswerOrder>& answers) {
    for (const action::AnswerOrder& each : answers) {
      answers_.push_back(absl::StrCat(each.token, " ", each.answer.decided_level, " ",
                                      each.answer.status.ToString()));
    }
  }

  WaitingOrders orders_;
  std::vector<std::string> answers_;
};

TEST_F(WaitingOrdersTest, AnOrderIsAnsweredOnceWhenItsDecisionIsDurable) {
  Wait(1, "a");
  Keep(orders_.OnDurable(At(2)));
  EXPECT_THAT(answers_, IsEmpty());
  Keep(orders_.OnDurable(At(1)));
  Keep(orders_.OnDurable(At(1)));
  Keep(orders_.Refuse(At(1), absl::FailedPreconditionError("too late")));
  EXPECT_THAT(answers_, ElementsAre("1 a OK"));
}

TEST_F(WaitingOrdersTest, ARepeatedOrderGetsTheAnswerOfTheFirst) {
  EXPECT_FALSE(orders_.Repeated("a"));
  Wait(1, "a");
  ASSERT_TRUE(orders_.Repeated("a"));
  EXPECT_TRUE(absl::IsUnavailable(orders_.Repeated("a")->status));
  Keep(orders_.OnDurable(At(1)));
  EXPECT_TRUE(orders_.Repeated("a")->status.ok());
  EXPECT_EQ(orders_.Repeated("a")->decided_level, "a");
  Wait(2, "");
  EXPECT_FALSE(orders_.Repeated("")) << "without an id it repeats none";
}

TEST_F(WaitingOrdersTest, WhatWasRefusedMayBeOrderedAgain) {
  Wait(1, "a");
  Keep(orders_.Refuse(At(1), absl::FailedPreconditionError("taken back")));
  EXPECT_THAT(answers_, ElementsAre("1 a FAILED_PRECONDITION: taken back"));
  EXPECT_FALSE(orders_.Repeated("a"));
}

TEST_F(WaitingOrdersTest, AllAreAnsweredWhenTheServerStops) {
  Wait(1, "a");
  Wait(2, "b");
  Keep(orders_.RefuseAll(absl::UnavailableError("stopping")));
  Keep(orders_.RefuseAll(absl::UnavailableError("stopping")));
  EXPECT_THAT(answers_, ElementsAre("1 a UNAVAILABLE: stopping", "2 b UNAVAILABLE: stopping"));
}

TEST_F(WaitingOrdersTest, TheNewestAnswersAreKept) {
  for (uint64_t i = 0; i <= WaitingOrders::kAnswersKept; ++i) {
    Wait(i, absl::StrCat("order ", i));
    Keep(orders_.OnDurable(At(i)));
  }
  EXPECT_FALSE(orders_.Repeated("order 0"));
  EXPECT_TRUE(orders_.Repeated("order 1"));
}

}  // namespace
}  // namespace rips::pipeline
