#include <algorithm>
#include <string>
#include <vector>

#include "absl/strings/escaping.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/ros2/cdr.h"
#include "services/ros2/discovery_info.h"
#include "tests/support/robot_sim/bad_discovery.h"
#include "tests/support/robot_sim/ros_messages.h"
#include "tests/support/ros2/server_messages.h"

namespace rips::robot_sim {
namespace {

std::string Hex(absl::string_view bytes) { return absl::BytesToHexString(bytes); }

// Unix time 0x6b0085b8 s, recorded with the first message.
constexpr int64_t kRecordedSeconds = 0x6b0085b8;

// As recorded from nodes of ROS 2 Humble over rmw_cyclonedds.
TEST(RosMessagesTest, ParameterEventIsAsRecorded) {
  EXPECT_EQ(Hex(EncodeParameterEvent(kRecordedSeconds * 1'000'000'000 + 0x29702927, "/drive_base",
                                     {{"max_speed", 0.0}}, {})),
            "00010000b885006b272970290c0000002f64726976655f6261736500010000000a0000006d61785f"
            "73706565640003000000000000000000000000000000000000000000010000000000000000000000"
            "000000000000000000000000000000000000000000000000");
  EXPECT_EQ(Hex(EncodeParameterEvent(kRecordedSeconds * 1'000'000'000 + 0x2985ecc8, "/drive_base",
                                     {{"controller", std::string("none")}}, {})),
            "00010000b885006bc8ec85290c0000002f64726976655f6261736500010000000b000000636f6e74"
            "726f6c6c657200040000000000000000000000000000000000000000050000006e6f6e6500000000"
            "00000000000000000000000000000000000000000000000000000000");
}

TEST(RosMessagesTest, TransitionEventIsAsRecorded) {
  EXPECT_EQ(
      Hex(EncodeTransitionEvent({2, "inactive"}, {13, "activating"})),
      "00010000000000000000000000000000010000000002000009000000696e616374697665000d00000b000000"
      "61637469766174696e670000");
}

TEST(RosMessagesTest, TwistRoundTripsAndIsRefusedWhenCut) {
  const std::string payload = EncodeTwist({.linear_x = 0.5, .angular_z = -1.25});
  const absl::StatusOr<Twist> twist = DecodeTwist(payload);
  ASSERT_THAT(twist, IsOk());
  EXPECT_EQ(twist->linear_x, 0.5);
  EXPECT_EQ(twist->angular_z, -1.25);
  for (size_t size = 0; size < payload.size(); ++size) {
    EXPECT_THAT(DecodeTwist(payload.substr(0, size)), StatusIs(absl::StatusCode::kDataLoss))
        << size;
  }
  EXPECT_THAT(DecodeTwist(payload + std::string(4, '\0')), StatusIs(absl::StatusCode::kDataLoss));
}

TEST(RosMessagesTest, ImageIsCompleteCdr) {
  const std::string payload = EncodeImage(1'500'000'000, 7);
  ros2::CdrReader in(payload);
  EXPECT_EQ(in.U32(), 1U);
  EXPECT_EQ(in.U32(), 500'000'000U);
  EXPECT_EQ(in.String(), "camera_link");
  EXPECT_EQ(in.U32(), ImageSize().height);
  EXPECT_EQ(in.U32(), ImageSize().width);
  EXPECT_EQ(in.String(), "rgb8");
  EXPECT_EQ(in.U8(), 0);
  const uint32_t step = in.U32();
  const uint32_t bytes = in.U32();
  EXPECT_EQ(bytes, step * ImageSize().height);
  EXPECT_EQ(in.Octets(bytes).size(), bytes);
  EXPECT_THAT(in.Finish(), IsOk());
}

TEST(RosMessagesTest, OdometryAndScanHaveTheirSizes) {
  // Stamp, two names, 7 + 36 + 6 + 36 doubles.
  EXPECT_EQ(EncodeOdometry(0, {.x = 1, .speed_x = 2}).size(),
            4U + 8 + (4 + 5 + 3) + (4 + 10 + 2) + 4 + 85 * 8);
  // Stamp, name, 7 floats, 360 rays, no intensities.
  EXPECT_EQ(EncodeLaserScan(0, 4).size(), 4U + 8 + (4 + 11 + 1) + 7 * 4 + 4 + 360 * 4 + 4);
}

TEST(RosMessagesTest, OdometryRoundTripsAndIsRefusedWhenCut) {
  const std::string payload =
      EncodeOdometry(5, {.x = 1.5, .y = -2, .speed_x = 0.25, .speed_y = 0.5});
  const absl::StatusOr<Odometry> odometry = DecodeOdometry(payload);
  ASSERT_THAT(odometry, IsOk());
  EXPECT_EQ(odometry->x, 1.5);
  EXPECT_EQ(odometry->y, -2);
  EXPECT_EQ(odometry->speed_x, 0.25);
  EXPECT_EQ(odometry->speed_y, 0.5);
  EXPECT_THAT(DecodeOdometry(payload.substr(0, payload.size() - 8)),
              StatusIs(absl::StatusCode::kDataLoss));
}

TEST(RosMessagesTest, AGridIsCountedAndRefusedIfItMakesNoSense) {
  const char cells[] = {0, 100, 0, 0, 100, 0};
  const absl::string_view six(cells, 6);
  const std::string payload = EncodeOccupancyGrid(5, 3, 2, 0.05, six);
  const absl::StatusOr<CellCount> count = CountOccupancyGrid(payload);
  ASSERT_THAT(count, IsOk());
  EXPECT_EQ(count->free, 4);
  EXPECT_EQ(count->occupied, 2);
  const char unknown[] = {0, 100, 0, 0, 50, 0};
  for (const std::string& bad :
       {payload.substr(0, payload.size() - 4), EncodeOccupancyGrid(5, 2, 2, 0.05, six),
        EncodeOccupancyGrid(5, 3, 2, 0.05, {unknown, 6})}) {
    EXPECT_THAT(CountOccupancyGrid(bad), StatusIs(absl::StatusCode::kDataLoss));
  }
}

TEST(BadDiscoveryTest, AllAreRefusedAndTheForeignOneSpeaksForAnother) {
  ros2::Guid sender;
  sender.bytes = {1, 0x10, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 0, 0, 1, 0xc1};
  ros2::Guid writer = sender;
  writer.bytes[15] = 0x03;
  size_t foreign = 0;
  size_t misnamed = 0;
  for (const BadDiscoveryMessage& message : BadDiscoveryMessages(sender)) {
    const auto info = ros2::DecodeParticipantEntities(message.payload, {}, &misnamed);
    if (message.name == "name that is no ROS name") {
      ASSERT_THAT(info, IsOk());
      EXPECT_EQ(info->nodes.size(), 0U);
      EXPECT_EQ(misnamed, 1U);
      continue;
    }
    if (message.name != "foreign gid") {
      EXPECT_THAT(info, StatusIs(absl::StatusCode::kDataLoss)) << message.name;
      continue;
    }
    ++foreign;
    ASSERT_THAT(info, IsOk());
    EXPECT_THAT(ros2::CheckOrigin(*info, writer), StatusIs(absl::StatusCode::kPermissionDenied));
  }
  EXPECT_EQ(foreign, 1U);
}

}  // namespace
}  // namespace rips::robot_sim
