#include "policy_server/server/rollout/alert_rates.h"

#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/robot/fake_ports.h"
#include "services/base/fake_clock.h"

namespace rips::rollout {
namespace {

class AlertRatesTest : public ::testing::Test {
 protected:
  void Raise(const std::string& robot, const std::string& rule, const std::string& severity) {
    rates_.OnAlert({.robot = robot, .rule = rule, .severity = severity});
  }

  FakeClock clock_;
  pipeline::FakeObserver next_;
  AlertRates rates_{&next_, &clock_};
};

TEST_F(AlertRatesTest, CountsAlertsOfRulesFromMediumOnOfTheLastMinute) {
  rates_.Watch("r1");
  Raise("r1", "spy", "medium");
  Raise("r1", "spy", "critical");
  for (const char* severity : {"info", "low"}) Raise("r1", "spy", severity);
  Raise("r1", "(rips)", "critical");
  Raise("r2", "spy", "critical");
  EXPECT_EQ(rates_.Count("r1"), 2u);
  EXPECT_EQ(rates_.Count("r2"), 0u) << "it is not watched";
  EXPECT_EQ(next_.alerts.size(), 6u) << "all go on";
  clock_.Advance(30 * kNanosPerSecond);
  Raise("r1", "spy", "high");
  EXPECT_EQ(rates_.Count("r1"), 3u);
  clock_.Advance(30 * kNanosPerSecond);
  EXPECT_EQ(rates_.Count("r1"), 1u);
}

TEST_F(AlertRatesTest, BeginsAtZeroWhenItIsWatchedAnewAndEndsWithClear) {
  rates_.Watch("r1");
  Raise("r1", "spy", "high");
  rates_.Watch("r1");
  EXPECT_EQ(rates_.Count("r1"), 0u);
  Raise("r1", "spy", "high");
  rates_.Clear();
  EXPECT_EQ(rates_.Count("r1"), 0u);
  Raise("r1", "spy", "high");
  EXPECT_EQ(rates_.Count("r1"), 0u);
}

TEST_F(AlertRatesTest, HoldsNoMoreThanTheLargestBoundNeeds) {
  rates_.Watch("r1");
  for (size_t i = 0; i < 2 * AlertRates::kCountMax; ++i) Raise("r1", "spy", "high");
  EXPECT_EQ(rates_.Count("r1"), AlertRates::kCountMax);
  EXPECT_GT(AlertRates::kCountMax, kAlertsPerMinuteMax);
}

}  // namespace
}  // namespace rips::rollout
