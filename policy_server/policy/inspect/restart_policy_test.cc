#include "policy_server/policy/inspect/restart_policy.h"

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
#include "services/base/clock.h"

namespace rips::inspect {
namespace {

constexpr int64_t kMs = kNanosPerMilli;
constexpr int64_t kStart = 1'000'000 * kMs;

TEST(RestartPolicyTest, AFailedStartMakesAllWaitTwiceAsLongEachTime) {
  RestartPolicy policy({});
  int64_t now = kStart;
  EXPECT_TRUE(policy.MayAsk("r1", now));
  for (const int64_t wait_ms : {100, 200, 400, 800, 1600, 3200, 5000, 5000}) {
    policy.StartFailed(now);
    EXPECT_FALSE(policy.MayAsk("r1", now + wait_ms * kMs - 1)) << wait_ms;
    EXPECT_FALSE(policy.MayAsk("r2", now + wait_ms * kMs - 1)) << wait_ms;
    now += wait_ms * kMs;
    EXPECT_TRUE(policy.MayAsk("r1", now)) << wait_ms;
  }
}

TEST(RestartPolicyTest, AFailedAnswerMakesOnlyItsRobotWait) {
  RestartPolicy policy({});
  policy.AnswerFailed("r1", kStart);
  EXPECT_FALSE(policy.MayAsk("r1", kStart + 100 * kMs - 1));
  EXPECT_TRUE(policy.MayAsk("r2", kStart));
  EXPECT_TRUE(policy.MayAsk("r1", kStart + 100 * kMs));
  policy.AnswerFailed("r1", kStart + 100 * kMs);
  EXPECT_FALSE(policy.MayAsk("r1", kStart + 300 * kMs - 1));
}

TEST(RestartPolicyTest, AfterALongTimeWithoutFailureTheFirstWaitIsShortAgain) {
  RestartPolicy policy({});
  int64_t now = kStart;
  for (int i = 0; i < 10; ++i) policy.AnswerFailed("r1", now += 5000 * kMs);
  EXPECT_FALSE(policy.MayAsk("r1", now + 4999 * kMs));

  now += 10'001 * kMs;
  policy.AnswerFailed("r1", now);
  EXPECT_TRUE(policy.MayAsk("r1", now + 100 * kMs));
}

TEST(RestartPolicyTest, RobotsRememberedAreLimited) {
  RestartPolicy policy({.robots_max = 10});
  for (int i = 0; i < 10; ++i) policy.AnswerFailed(absl::StrCat("r", i), kStart);
  EXPECT_TRUE(policy.MayAsk("r10", kStart));

  policy.AnswerFailed("r10", kStart);
  EXPECT_FALSE(policy.MayAsk("r10", kStart)) << "all wait";
  EXPECT_FALSE(policy.MayAsk("r99", kStart));

  // Those whose wait is over make room.
  policy.AnswerFailed("r11", kStart + 200 * kMs);
  EXPECT_FALSE(policy.MayAsk("r11", kStart + 200 * kMs));
  EXPECT_TRUE(policy.MayAsk("r99", kStart + 200 * kMs));
}

}  // namespace
}  // namespace rips::inspect
