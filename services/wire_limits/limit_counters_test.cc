#include "services/wire_limits/limit_counters.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "rips/v1/actuator.pb.h"

namespace rips::wire_limits {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(LimitCountersTest, EveryLimitIsOnThePageAndCountsByItsField) {
  Metrics metrics;
  const LimitCounters counters(&metrics);
  EXPECT_THAT(metrics.Text(), HasSubstr("field=\"Loss.count\"} 0"));
  EXPECT_THAT(metrics.Text(), Not(HasSubstr("field=\"DecisionId.term\"")));
  v1::ActuatorMessage message;
  message.mutable_heartbeat()->set_floor_reason(std::string(1'025, 'x'));
  const auto hit = Check(message);
  ASSERT_TRUE(hit.has_value());
  const LimitCounters copy = counters;
  copy.Count(*hit);
  counters.Count(*hit);
  EXPECT_THAT(metrics.Text(), HasSubstr("field=\"ActuatorHeartbeat.floor_reason\"} 2"));
  LimitCounters().Count(*hit);  // of nothing
}

}  // namespace
}  // namespace rips::wire_limits
