#include "policy_server/server/operator_api/caller_quota.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"

namespace rips::operator_api {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class CallerQuotaTest : public ::testing::Test {
 protected:
  absl::Status Take(const std::string& who, Use use, bool privileged = false, double weight = 1) {
    auto ticket = quota_->Take(who, privileged, use, weight);
    if (!ticket.ok()) return ticket.status();
    held_.push_back(*std::move(ticket));
    return absl::OkStatus();
  }

  FakeClock clock_;
  int refused_ = 0;
  std::shared_ptr<CallerQuota> quota_ =
      CallerQuota::Create(&clock_,
                          {.streams = {.at_a_time = 3, .per_second = 1, .burst = 100},
                           .queries = {.at_a_time = 2, .per_second = 10, .burst = 20},
                           .orders = {.at_a_time = 2, .per_second = 1, .burst = 2},
                           .streams_in_all = 8,
                           .streams_reserved = 2},
                          [this] { ++refused_; });
  std::vector<CallerQuota::Ticket> held_;
};

TEST_F(CallerQuotaTest, OneIdentityHasSoManyStreamsAndAllButTheReserveTogether) {
  for (const char* who : {"a", "b"}) {
    for (int i = 0; i < 3; ++i) ASSERT_THAT(Take(who, Use::kStream), IsOk());
    EXPECT_THAT(Take(who, Use::kStream),
                StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("3 streams under way")));
  }
  EXPECT_THAT(Take("c", Use::kStream), StatusIs(absl::StatusCode::kResourceExhausted,
                                                HasSubstr("the limit for this role is 6")));
  EXPECT_THAT(Take("alice", Use::kStream, /*privileged=*/true), IsOk());
  EXPECT_EQ(refused_, 3);
  held_.erase(held_.begin());
  EXPECT_THAT(Take("c", Use::kStream), Not(IsOk())) << "the operator's counts";
  held_.clear();
  EXPECT_THAT(Take("c", Use::kStream), IsOk());
}

TEST_F(CallerQuotaTest, QueriesAreLimitedAtATimeAndByTheSecond) {
  for (int i = 0; i < 2; ++i) ASSERT_THAT(Take("a", Use::kQuery), IsOk());
  EXPECT_THAT(Take("a", Use::kQuery), Not(IsOk()));
  EXPECT_THAT(Take("b", Use::kQuery), IsOk()) << "others have their own";
  held_.clear();
  int taken = 0;
  while (Take("a", Use::kQuery).ok()) {
    held_.clear();
    ++taken;
  }
  EXPECT_EQ(taken, 18);
  EXPECT_THAT(Take("a", Use::kQuery), StatusIs(absl::StatusCode::kResourceExhausted,
                                               HasSubstr("more than 10 calls a second")));
  clock_.Advance(kNanosPerSecond / 2);
  EXPECT_THAT(Take("a", Use::kQuery, false, /*weight=*/6), Not(IsOk()));
  EXPECT_THAT(Take("a", Use::kQuery, false, /*weight=*/5), IsOk());
}

TEST_F(CallerQuotaTest, OrdersAreRefusedOnlyForOrders) {
  while (Take("alice", Use::kQuery, true).ok()) {
  }
  while (Take("alice", Use::kStream, true).ok()) {
  }
  for (int i = 0; i < 2; ++i) EXPECT_THAT(Take("alice", Use::kOrder, true), IsOk());
  EXPECT_THAT(Take("alice", Use::kOrder, true), Not(IsOk()));
}

TEST_F(CallerQuotaTest, OrdersInTheLongRunAreFewer) {
  quota_ = CallerQuota::Create(&clock_, {.orders = {.at_a_time = 5,
                                                    .per_second = 50,
                                                    .burst = 100,
                                                    .lasting_per_second = 1,
                                                    .reserve = 200}});
  int taken = 0;
  const auto take_all = [&] {
    while (Take("alice", Use::kOrder, true).ok()) {
      held_.clear();
      ++taken;
    }
  };
  take_all();
  EXPECT_EQ(taken, 100) << "of one burst";
  clock_.Advance(3600 * kNanosPerSecond);
  take_all();
  EXPECT_EQ(taken, 200);
  for (int i = 0; i < 60; ++i) {
    clock_.Advance(2 * kNanosPerSecond);
    take_all();
  }
  EXPECT_EQ(taken, 200 + 100 + 120) << "what was in reserve, and one a second";
  EXPECT_THAT(Take("alice", Use::kOrder, true),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("used up its reserve of 200 orders; from now on 1 a second; "
                                 "another operator's has its own")));
  EXPECT_THAT(Take("alice", Use::kQuery, true), IsOk());
  EXPECT_THAT(Take("bob", Use::kOrder, true), IsOk()) << "others have their own";
  EXPECT_EQ(quota_->accounts(), 2u);
  held_.clear();
  clock_.Advance(100 * kNanosPerSecond);
  ASSERT_THAT(Take("bob", Use::kQuery, true), IsOk());
  EXPECT_EQ(quota_->accounts(), 2u) << "not forgotten before it is full again";
  clock_.Advance(200 * kNanosPerSecond);
  ASSERT_THAT(Take("bob", Use::kQuery, true), IsOk());
  EXPECT_EQ(quota_->accounts(), 1u);
}

TEST_F(CallerQuotaTest, IdentitiesThatUseNothingAreForgottenAndATicketOutlivesTheQuota) {
  for (int i = 0; i < 100; ++i) ASSERT_THAT(Take(absl::StrCat(i), Use::kQuery), IsOk());
  EXPECT_EQ(quota_->accounts(), 100u);
  held_.resize(1);
  clock_.Advance(1'000 * kNanosPerSecond);
  ASSERT_THAT(Take("b", Use::kQuery), IsOk());
  EXPECT_EQ(quota_->accounts(), 2u) << "the one that is used, and the new one";
  quota_.reset();
  held_.clear();
}

}  // namespace
}  // namespace rips::operator_api
