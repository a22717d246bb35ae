#include "policy_server/server/operator_api/answer_limits.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::operator_api {
namespace {

using ::testing::EndsWith;
using ::testing::SizeIs;

pipeline::RobotStatus Status(const std::string& robot, size_t texts, size_t bytes) {
  pipeline::RobotStatus status{
      .robot = robot, .decided_level = "ALERT", .stage = "verified", .decision_id = {1, 2}};
  status.degraded.assign(texts, std::string(bytes, 'x'));
  return status;
}

TEST(AnswerLimitsTest, AStatusWithinTheLimitsIsWhole) {
  const rips::v1::RobotStatus status = EncodeStatus(Status("r1", 64, 512));
  EXPECT_FALSE(status.degraded_cut());
  EXPECT_EQ(status.robot(), "r1");
  EXPECT_EQ(status.decided_level(), "ALERT");
  EXPECT_EQ(status.decision_id().epoch(), 2u);
  EXPECT_THAT(status.degraded(), SizeIs(64));
}

TEST(AnswerLimitsTest, MoreOrLongerTextsAreCutAndItIsSaid) {
  const rips::v1::RobotStatus many = EncodeStatus(Status("r1", 65, 1));
  EXPECT_TRUE(many.degraded_cut());
  EXPECT_THAT(many.degraded(), SizeIs(64));
  const rips::v1::RobotStatus lengthy = EncodeStatus(Status("r1", 1, 4 << 20));
  EXPECT_TRUE(lengthy.degraded_cut());
  EXPECT_THAT(lengthy.degraded(0), SizeIs(512));
  EXPECT_THAT(lengthy.degraded(0), EndsWith("..."));
}

// A robot with much to say takes the others nothing, and none is missing.
TEST(AnswerLimitsTest, AListOfAllRobotsFitsWhateverTheySay) {
  rips::v1::ListRobotsResponse response;
  *response.add_robots() = EncodeStatus(Status("quiet", 2, 100));
  for (int i = 0; i < 1'999; ++i) {
    *response.add_robots() = EncodeStatus(Status(absl::StrCat("loud", i), 64, 512));
  }
  FitStatuses(response);
  EXPECT_LE(response.ByteSizeLong(), kAnswerBytesMax);
  EXPECT_THAT(response.robots(), SizeIs(2'000));
  EXPECT_THAT(response.robots(0).degraded(), SizeIs(2));
  EXPECT_FALSE(response.robots(0).degraded_cut());
  EXPECT_EQ(response.robots(7).decided_level(), "ALERT");
  EXPECT_TRUE(response.robots(7).degraded_cut());
}

TEST(AnswerLimitsTest, AListThatFitsStaysAsItIs) {
  rips::v1::ListRobotsResponse response;
  for (int i = 0; i < 50; ++i) {
    *response.add_robots() = EncodeStatus(Status(absl::StrCat("r", i), 64, 512));
  }
  const std::string before = response.SerializeAsString();
  FitStatuses(response);
  EXPECT_EQ(response.SerializeAsString(), before);
}

TEST(AnswerLimitsTest, RoomIsTakenInOrderAndThenThereIsNone) {
  rips::v1::Alert alert;
  alert.set_text(std::string(1'000, 'x'));
  AnswerRoom room(2'500);
  EXPECT_TRUE(room.Take(alert));
  EXPECT_TRUE(room.Take(alert));
  EXPECT_FALSE(room.Take(alert));
  EXPECT_FALSE(room.Take(rips::v1::Alert())) << "what follows would come out of order";
}

TEST(AnswerLimitsTest, AGraphThatIsTooLongLosesEndpointsFirstAndSaysHowMany) {
  rips::v1::GetGraphResponse response;
  for (int i = 0; i < 100; ++i) {
    response.mutable_graph()->add_nodes()->set_full_name(std::string(100, 'n'));
    response.mutable_graph()->add_endpoints()->set_name(std::string(500, 'e'));
  }
  rips::v1::GetGraphResponse small = response;
  FitGraph(response, 20'000);
  EXPECT_LE(response.ByteSizeLong(), 20'010u);
  EXPECT_EQ(response.graph().nodes_size(), 100);
  EXPECT_EQ(response.left_out(), 100u - response.graph().endpoints_size());
  EXPECT_GT(response.graph().endpoints_size(), 10);
  FitGraph(small, 5'000);
  EXPECT_EQ(small.graph().endpoints_size(), 0);
  EXPECT_LE(small.ByteSizeLong(), 5'010u);
}

}  // namespace
}  // namespace rips::operator_api
