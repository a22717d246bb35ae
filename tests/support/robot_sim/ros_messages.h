// The messages the simulated robot sends besides those of services/ros2: CDR payloads with
// encapsulation header, little endian. Stamps come from nanoseconds since the Unix epoch.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_ROS_MESSAGES_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_ROS_MESSAGES_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/steps/system_mode/smh.h"
#include "services/ros2/system_modes_messages.h"

namespace rips::robot_sim {

// Pixels of a picture.
struct ImageSize {
  uint32_t width = 160;
  uint32_t height = 120;
};
// sensor_msgs/msg/Image, rgb8; `frame` shifts the picture. Black if the lens is covered.
std::string EncodeImage(int64_t unix_ns, uint32_t frame, ImageSize size = {}, bool covered = false);

// sensor_msgs/msg/LaserScan: 360 rays around the robot, `distance` metres each.
std::string EncodeLaserScan(int64_t unix_ns, double distance);

// nav_msgs/msg/Odometry: metres from the origin and m/s; the other members are 0.
struct Odometry {
  double x = 0;
  double y = 0;
  double speed_x = 0;
  double speed_y = 0;
};
std::string EncodeOdometry(int64_t unix_ns, const Odometry& odometry);
// DataLoss if malformed.
absl::StatusOr<Odometry> DecodeOdometry(absl::string_view payload);

// nav_msgs/msg/OccupancyGrid: `cells` row by row, as many as `width` x `height`; 0 = free,
// 100 = occupied.
std::string EncodeOccupancyGrid(int64_t unix_ns, uint32_t width, uint32_t height, double cell_m,
                                absl::string_view cells);
struct CellCount {
  int64_t free = 0;
  int64_t occupied = 0;
};
// DataLoss if malformed, or a cell is neither.
absl::StatusOr<CellCount> CountOccupancyGrid(absl::string_view payload);

// geometry_msgs/msg/Twist: m/s ahead and to the left, rad/s to the left; the other members are 0.
struct Twist {
  double linear_x = 0;
  double linear_y = 0;
  double angular_z = 0;
};
std::string EncodeTwist(const Twist& twist);
// DataLoss if malformed.
absl::StatusOr<Twist> DecodeTwist(absl::string_view payload);

// rcl_interfaces/msg/Log at level INFO.
std::string EncodeLog(int64_t unix_ns, absl::string_view node, absl::string_view text);

// rcl_interfaces/msg/ParameterEvent: `added` are new, `changed` are changed.
std::string EncodeParameterEvent(int64_t unix_ns, absl::string_view node,
                                 const actuator::ParameterMap& added,
                                 const actuator::ParameterMap& changed);

// lifecycle_msgs/msg/TransitionEvent. Timestamp and transition stay empty, as rclcpp leaves them.
std::string EncodeTransitionEvent(const ros2::LifecycleLabel& start,
                                  const ros2::LifecycleLabel& goal);

// system_modes_msgs/msg/ModeEvent. The timestamp stays 0, as mode_manager leaves it.
std::string EncodeModeEvent(absl::string_view start, absl::string_view goal);

// Reply of rcl_interfaces/srv/ListParameters.
std::string EncodeListParametersReply(const std::vector<std::string>& names);

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_ROS_MESSAGES_H_
