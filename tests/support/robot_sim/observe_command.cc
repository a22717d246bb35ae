#include <cmath>
#include <memory>

#include "absl/status/statusor.h"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/commands.h"
#include "tests/support/robot_sim/events.h"
#include "tests/support/robot_sim/ros_messages.h"
#include "tests/support/robot_sim/ros_process.h"

namespace rips::robot_sim {
namespace {

// Of a camera that runs faster than its host wakes a thread.
constexpr uint32_t kPicturesKept = 200;
constexpr absl::Duration kBetweenLooks = absl::Milliseconds(50);

void PrintMalformed(absl::string_view topic, const absl::Status& status) {
  LogError("malformed message", {{"topic", topic}, {"error", status.message()}});
}

void OnGrid(const dds::RawSample& sample) {
  const absl::StatusOr<CellCount> cells = CountOccupancyGrid(sample.payload);
  if (!cells.ok()) return PrintMalformed("/global_costmap/costmap", cells.status());
  PrintEvent({{"event", "cells"},
              {"free", cells->free},
              {"occupied", cells->occupied},
              {"unix_ns", sample.received.unix_ns}});
}

void OnOdometry(const dds::RawSample& sample) {
  const absl::StatusOr<Odometry> odometry = DecodeOdometry(sample.payload);
  if (!odometry.ok()) return PrintMalformed("/odometry/filtered", odometry.status());
  PrintEvent({{"event", "pose"},
              {"x", odometry->x},
              {"y", odometry->y},
              {"speed", std::hypot(odometry->speed_x, odometry->speed_y)},
              {"unix_ns", sample.received.unix_ns}});
}

dds::RawCallback Print(const char* event) {
  return [event](const dds::RawSample& sample) {
    PrintEvent({{"event", event}, {"unix_ns", sample.received.unix_ns}});
  };
}

}  // namespace

absl::Status RunObserve(const ObserveCommand& command, StopFlag& stop) {
  RIPS_ASSIGN_OR_RETURN(std::shared_ptr<const dds::Domain> domain,
                        dds::Domain::Create(command.domain));
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<RosProcess> process,
                        RosProcess::Create(domain, ros2::GidBytes::k24));
  RIPS_ASSIGN_OR_RETURN(RosNode * node, process->AddNode(command.node));
  ros2::Qos pictures = SensorDataQos();
  pictures.depth = kPicturesKept;
  RIPS_RETURN_IF_ERROR(
      node->Subscribe("/camera/image_raw", "sensor_msgs/msg/Image", pictures, Print("frame")));
  RIPS_RETURN_IF_ERROR(node->Subscribe("/global_costmap/costmap", "nav_msgs/msg/OccupancyGrid",
                                       DefaultQos(), OnGrid));
  RIPS_RETURN_IF_ERROR(
      node->Subscribe("/odometry/filtered", "nav_msgs/msg/Odometry", DefaultQos(), OnOdometry));
  RIPS_RETURN_IF_ERROR(
      node->Subscribe("/cmd_vel", "geometry_msgs/msg/Twist", DefaultQos(), Print("twist")));
  RIPS_RETURN_IF_ERROR(process->Announce());
  PrintEvent({{"event", "ready"}, {"unix_ns", RealClock().Now().unix_ns}});
  while (!stop.WaitFor(kBetweenLooks)) {
  }
  return absl::OkStatus();
}

}  // namespace rips::robot_sim
