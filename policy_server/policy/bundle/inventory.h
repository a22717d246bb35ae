// The robots this server guards: robots.yaml. Who is not listed may not connect.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_INVENTORY_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_INVENTORY_H_

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/base/config_setting.h"
#include "services/ros2/graph_limits.h"

namespace rips::bundle {

inline constexpr size_t kRobotsMax = 2'000;
// Sensors of one robot, and actuators of one robot.
inline constexpr size_t kHostsMax = 16;
// Of one robot.
inline constexpr size_t kLabelsMax = 16;
// Entries of `bundles`, and of `sensor_settings`, in all files.
inline constexpr size_t kLabelEntriesMax = 256;
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
  // Name of its bundle. Empty until AssignByLabels if the robot names none.
  std::string bundle;
  // At least one; hosts are distinct.
  std::vector<InventorySensor> sensors;
  // Hosts, distinct. A level is verified when all of them say so. Empty: the robot is only watched,
  // and no level is ever verified.
  std::vector<std::string> actuators;
  // What the server holds of its graph.
  ros2::GraphLimits graph_limits;
  // What groups robots, for example for roll-outs: `ring: canary`. Keys and values are names as in
  // IsValidName.
  absl::btree_map<std::string, std::string> labels;
  // What its sensors are to follow of their configuration, where their files allow it. Empty until
  // AssignByLabels.
  std::vector<ConfigSetting> sensor_settings;

  // `label` is `KEY=VALUE`; false for one that ParseLabel refuses.
  bool HasLabel(absl::string_view label) const;

  friend bool operator==(const InventoryRobot&, const InventoryRobot&) = default;
};

// The bundle of robots that name none and have all of these labels.
struct LabelBundle {
  absl::btree_map<std::string, std::string> labels;  // empty = any robot
  std::string bundle;
  std::string source;  // `FILE:LINE`
};

// What sensors of robots that have all of these labels are to follow.
struct LabelSettings {
  absl::btree_map<std::string, std::string> labels;  // empty = any robot
  std::vector<ConfigSetting> settings;               // at least one
  std::string source;                                // `FILE:LINE`
};

struct Inventory {
  // Sorted by id; ids are distinct. May be empty.
  std::vector<InventoryRobot> robots;
  // The first that fits a robot decides.
  std::vector<LabelBundle> bundles;
  // All that fit a robot hold; of those that set the same, the first.
  std::vector<LabelSettings> sensor_settings;
  // What is valid and does nothing, with its place. From AssignByLabels.
  std::vector<std::string> warnings;
  // What is in force for each robot, by its id, and which line says it.
  absl::btree_map<std::string, std::vector<ConfigSetting>> settings;

  // nullptr if it is not listed. Valid as long as this.
  const InventoryRobot* Find(absl::string_view id) const;
};

// The key and the value of `KEY=VALUE`. InvalidArgument if one of them is no name.
absl::StatusOr<std::pair<std::string, std::string>> ParseLabel(absl::string_view label);

// InvalidArgument with every problem and its place.
absl::StatusOr<Inventory> ParseInventory(absl::string_view file, absl::string_view text);

// Gives a bundle to robots that name none, and each robot the settings of its sensors.
// InvalidArgument with each robot for which there is no bundle.
absl::Status AssignByLabels(Inventory& inventory);

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_INVENTORY_H_
