#include "policy_server/server/robot/parts/waiting_orders.h"

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
    orders_.Wait(
        At(epoch), request_id, {.decided_level = request_id}, [this](const LevelAnswer& answer) {
          answers_.push_back(absl::StrCat(answer.decided_level, " ", answer.status.ToString()));
        });
  }
  static DecisionId At(uint64_t epoch) { return {.term = 1, .epoch = epoch}; }

  WaitingOrders orders_;
  std::vector<std::string> answers_;
};

TEST_F(WaitingOrdersTest, AnOrderIsAnsweredOnceWhenItsDecisionIsDurable) {
  Wait(1, "a");
  orders_.OnDurable(At(2));
  EXPECT_THAT(answers_, IsEmpty());
  orders_.OnDurable(At(1));
  orders_.OnDurable(At(1));
  orders_.Refuse(At(1), absl::FailedPreconditionError("too late"));
  EXPECT_THAT(answers_, ElementsAre("a OK"));
}

TEST_F(WaitingOrdersTest, ARepeatedOrderGetsTheAnswerOfTheFirst) {
  EXPECT_FALSE(orders_.Repeated("a"));
  Wait(1, "a");
  ASSERT_TRUE(orders_.Repeated("a"));
  EXPECT_TRUE(absl::IsUnavailable(orders_.Repeated("a")->status));
  orders_.OnDurable(At(1));
  EXPECT_TRUE(orders_.Repeated("a")->status.ok());
  EXPECT_EQ(orders_.Repeated("a")->decided_level, "a");
  Wait(2, "");
  EXPECT_FALSE(orders_.Repeated("")) << "without an id it repeats none";
}

TEST_F(WaitingOrdersTest, WhatWasRefusedMayBeOrderedAgain) {
  Wait(1, "a");
  orders_.Refuse(At(1), absl::FailedPreconditionError("taken back"));
  EXPECT_THAT(answers_, ElementsAre("a FAILED_PRECONDITION: taken back"));
  EXPECT_FALSE(orders_.Repeated("a"));
}

TEST_F(WaitingOrdersTest, AllAreAnsweredWhenTheServerStops) {
  Wait(1, "a");
  Wait(2, "b");
  orders_.RefuseAll(absl::UnavailableError("stopping"));
  orders_.RefuseAll(absl::UnavailableError("stopping"));
  EXPECT_THAT(answers_, ElementsAre("a UNAVAILABLE: stopping", "b UNAVAILABLE: stopping"));
}

TEST_F(WaitingOrdersTest, TheNewestAnswersAreKept) {
  for (uint64_t i = 0; i <= WaitingOrders::kAnswersKept; ++i) {
    Wait(i, absl::StrCat("order ", i));
    orders_.OnDurable(At(i));
  }
  EXPECT_FALSE(orders_.Repeated("order 0"));
  EXPECT_TRUE(orders_.Repeated("order 1"));
}

}  // namespace
}  // namespace rips::pipeline
