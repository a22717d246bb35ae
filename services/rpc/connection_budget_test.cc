#include "services/rpc/connection_budget.h"

#include "gtest/gtest.h"

namespace rips::rpc {
namespace {

constexpr int64_t kPollNs = 50 * kNanosPerMilli;

class ConnectionBudgetTest : public ::testing::Test {
 protected:
  Excess Check(int64_t after_ns = kPollNs) {
    now_ns_ += after_ns;
    return budget_.Check(received_, now_ns_);
  }

  void Admit() {
    budget_.OnCall(now_ns_);
    budget_.OnIdentified(/*agent=*/true);
  }

  int64_t now_ns_ = 77 * kNanosPerSecond;
  uint64_t received_ = 0;
  ConnectionBudget budget_{BudgetLimits(), 77 * kNanosPerSecond};
};

TEST_F(ConnectionBudgetTest, OneThatMakesNoCallIsEnded) {
  EXPECT_EQ(Check(15 * kNanosPerSecond), Excess::kNone);
  EXPECT_EQ(Check(), Excess::kSilent);
}

TEST_F(ConnectionBudgetTest, OneThatSendsMuchBeforeItIsIdentifiedIsEnded) {
  budget_.OnCall(now_ns_);
  received_ = 64 << 10;
  EXPECT_EQ(Check(), Excess::kNone) << "certificates are long";
  received_ += 2'000;
  EXPECT_EQ(Check(), Excess::kBytes);
}

TEST_F(ConnectionBudgetTest, AStreamOfMessagesGoesOnForEver) {
  Admit();
  for (int i = 0; i < 10'000; ++i) {
    received_ += 3'000'000 + 20'000;  // 60 MB a second, with framing
    budget_.OnMessage(3'000'000);
    ASSERT_EQ(Check(), Excess::kNone) << i;
  }
}

TEST_F(ConnectionBudgetTest, SmallMessagesPayForTheirFrames) {
  Admit();
  for (int i = 0; i < 10'000; ++i) {
    received_ += 1'000 * (20 + 40);
    for (int message = 0; message < 1'000; ++message) budget_.OnMessage(20);
    ASSERT_EQ(Check(), Excess::kNone) << i;
  }
}

TEST_F(ConnectionBudgetTest, BytesOfWhichNothingComesAreCounted) {
  Admit();
  int polls = 0;
  for (; polls < 1'000 && Check() == Excess::kNone; ++polls) received_ += 100'000;
  EXPECT_GT(polls, 240);
  EXPECT_LT(polls, 260);
}

TEST_F(ConnectionBudgetTest, AnOperatorSendsLessAheadOfItsMessages) {
  budget_.OnCall(now_ns_);
  budget_.OnIdentified(/*agent=*/false);
  int polls = 0;
  for (; polls < 1'000 && Check() == Excess::kNone; ++polls) received_ += 100'000;
  EXPECT_GT(polls, 60);
  EXPECT_LT(polls, 70);
}

TEST_F(ConnectionBudgetTest, HeartbeatsPayForNothingElse) {
  Admit();
  int polls = 0;
  for (; polls < 1'000 && Check() == Excess::kNone; ++polls) {
    received_ += 100'000;
    budget_.OnMessage(30);
  }
  EXPECT_LT(polls, 260);
}

TEST_F(ConnectionBudgetTest, YesterdaysMessagesAreNoCredit) {
  Admit();
  for (int i = 0; i < 1'000; ++i) {
    received_ += 1'000'000;
    budget_.OnMessage(1'000'000);
    ASSERT_EQ(Check(), Excess::kNone);
  }
  Check(86'400 * kNanosPerSecond);
  received_ += (24 << 20) + (300 << 10);
  EXPECT_EQ(Check(), Excess::kBytes);
}

TEST_F(ConnectionBudgetTest, AMessageIsAccountedForWhenItIsReadLate) {
  Admit();
  for (int i = 0; i < 100; ++i) {
    received_ += 4'400'000;
    ASSERT_EQ(Check(), Excess::kNone);
    ASSERT_EQ(Check(), Excess::kNone);
    budget_.OnMessage(4'400'000);
    ASSERT_EQ(Check(), Excess::kNone);
  }
}

TEST_F(ConnectionBudgetTest, PingsAreFree) {
  Admit();
  for (int i = 0; i < 100'000; ++i) {
    received_ += 100;
    ASSERT_EQ(Check(), Excess::kNone);
  }
}

TEST_F(ConnectionBudgetTest, CallsAreCounted) {
  for (int i = 0; i < 100; ++i) ASSERT_EQ(budget_.OnCall(now_ns_), Excess::kNone);
  EXPECT_EQ(budget_.OnCall(now_ns_), Excess::kCalls);
  now_ns_ += kNanosPerSecond;
  for (int i = 0; i < 20; ++i) ASSERT_EQ(budget_.OnCall(now_ns_), Excess::kNone);
  EXPECT_EQ(budget_.OnCall(now_ns_), Excess::kCalls);
}

TEST_F(ConnectionBudgetTest, ACounterThatGoesBackIsIgnored) {
  Admit();
  received_ = 1'000;
  EXPECT_EQ(Check(), Excess::kNone);
  received_ = 0;
  EXPECT_EQ(Check(), Excess::kNone);
}

}  // namespace
}  // namespace rips::rpc
