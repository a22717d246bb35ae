#include "policy_server/server/operator_api/overtaken_states.h"

#include "gmock/gmock.h"

namespace rips::operator_api {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

TEST(OvertakenStatesTest, TellsEachRobotOnceWhenAllWasRead) {
  OvertakenStates states;
  const auto few = [] { return OvertakenStates::kWaitingMax - 1; };
  const auto many = [] { return OvertakenStates::kWaitingMax; };
  EXPECT_FALSE(states.Skip("r1", few));
  EXPECT_TRUE(states.Skip("r2", many));
  EXPECT_TRUE(states.Skip("r1", many));
  EXPECT_TRUE(states.Skip("r2", many));
  EXPECT_THAT(states.Take(), ElementsAre("r1", "r2"));
  EXPECT_THAT(states.Take(), IsEmpty());
}

}  // namespace
}  // namespace rips::operator_api
