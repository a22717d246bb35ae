// The robots this server guards: robots.yaml. Who is not listed may not connect.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_INVENTORY_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_INVENTORY_H_

#include <cstddef>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/ros2/graph_limits.h"

namespace rips::bundle {

inline constexpr size_t kRobotsMax = 2'000;
// Sensors of one robot, and actuators of one robot.
inline constexpr size_t kHostsMax = 16;
// The largest of each limit on a graph: a server holds up to kRobotsMax graphs.
inline constexpr size_t kGraphLimitMax = 65'536;

struct InventorySensor {
  std::string host;
  // Sends graph and messages; the others add facts of their host. Exactly one a robot.
  bool primary = false;

  friend bool operator==(const InventorySensor&, const InventorySensor&) = default;
};

struct InventoryRobot {
  std::string id;
  // Name of its bundle.
  std::string bundle;
  // At least one; hosts are distinct.
  std::vector<InventorySensor> sensors;
  // Hosts, distinct. A level is verified when all of them say so. Empty: the robot is only watched,
  // and no level is ever verified.
  std::vector<std::string> actuators;
  // What the server holds of its graph.
  ros2::GraphLimits graph_limits;

  friend bool operator==(const InventoryRobot&, const InventoryRobot&) = default;
};

struct Inventory {
  // Sorted by id; ids are distinct. May be empty.
  std::vector<InventoryRobot> robots;

  // nullptr if it is not listed. Valid as long as this.
  const InventoryRobot* Find(absl::string_view id) const;
};

// InvalidArgument with every problem and its place.
absl::StatusOr<Inventory> ParseInventory(absl::string_view file, absl::string_view text);

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_INVENTORY_H_
