#include "policy_server/policy/bundle/inventory.h"

#include <algorithm>
#include <utility>

#include "absl/container/btree_set.h"
#include "absl/strings/str_cat.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_reader.h"
#include "services/runtime/config_sections.h"

namespace rips::bundle {
namespace {

void CheckCount(const ConfigSection& section, absl::string_view key, size_t count, size_t max) {
  if (count <= max) return;
  section.Problem(key, absl::StrCat(count, " ", key, " exceed limit ", max));
}

void ReadSensors(const ConfigSection& robot, std::vector<InventorySensor>* sensors) {
  absl::btree_set<std::string> hosts;
  for (const ConfigSection& section : robot.Sections("sensors")) {
    InventorySensor sensor;
    ReadName(section, "host", "host", &sensor.host);
    section.Optional("primary", &sensor.primary);
    if (!sensor.host.empty() && !hosts.insert(sensor.host).second) {
      section.Problem("host", absl::StrCat("sensor host `", sensor.host, "` is listed twice"));
    }
    sensors->push_back(std::move(sensor));
  }
  CheckCount(robot, "sensors", sensors->size(), kHostsMax);
  const auto primaries = std::count_if(sensors->begin(), sensors->end(),
                                       [](const InventorySensor& each) { return each.primary; });
  if (primaries != 1) {
    robot.Problem("sensors", absl::StrCat(primaries,
                                          " sensors are `primary`; exactly one must be, as in "
                                          "`sensors: [{host: base, primary: true}]`"));
  }
}

void ReadActuators(const ConfigSection& robot, std::vector<std::string>* actuators) {
  robot.Optional("actuators", actuators);
  CheckCount(robot, "actuators", actuators->size(), kHostsMax);
  absl::btree_set<absl::string_view> hosts;
  for (const std::string& host : *actuators) {
    if (const absl::Status status = ValidateName("host", host); !status.ok()) {
      robot.Problem("actuators", status.message());
    }
    if (!hosts.insert(host).second) {
      robot.Problem("actuators", absl::StrCat("actuator host `", host, "` is listed twice"));
    }
  }
}

void ReadGraphLimits(const ConfigSection& section, ros2::GraphLimits& limits) {
  ReadCount(section, "topics", kGraphLimitMax, &limits.topics);
  ReadCount(section, "participants", kGraphLimitMax, &limits.participants);
  ReadCount(section, "nodes", kGraphLimitMax, &limits.nodes);
  ReadCount(section, "endpoints", kGraphLimitMax, &limits.endpoints);
  ReadCount(section, "nodes_per_participant", kGraphLimitMax, &limits.nodes_per_participant);
  ReadCount(section, "endpoints_per_participant", kGraphLimitMax,
            &limits.endpoints_per_participant);
}

}  // namespace

const InventoryRobot* Inventory::Find(absl::string_view id) const {
  const auto it = std::lower_bound(
      robots.begin(), robots.end(), id,
      [](const InventoryRobot& robot, absl::string_view wanted) { return robot.id < wanted; });
  return it != robots.end() && it->id == id ? &*it : nullptr;
}

absl::StatusOr<Inventory> ParseInventory(absl::string_view file, absl::string_view text) {
  ConfigReader reader(file, text);
  const ConfigSection root = reader.root();
  Inventory inventory;
  absl::btree_set<std::string> ids;
  if (root.present() && !root.Has("robots")) root.Problem("robots", "missing key `robots`");
  for (const ConfigSection& section : root.Sections("robots")) {
    InventoryRobot robot;
    ReadName(section, "id", "robot id", &robot.id);
    ReadName(section, "bundle", "bundle name", &robot.bundle);
    ReadSensors(section, &robot.sensors);
    ReadActuators(section, &robot.actuators);
    ReadGraphLimits(section.OptionalSection("graph_limits"), robot.graph_limits);
    if (!robot.id.empty() && !ids.insert(robot.id).second) {
      section.Problem("id", absl::StrCat("robot `", robot.id, "` is listed twice"));
    }
    inventory.robots.push_back(std::move(robot));
  }
  CheckCount(root, "robots", inventory.robots.size(), kRobotsMax);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  std::sort(inventory.robots.begin(), inventory.robots.end(),
            [](const InventoryRobot& a, const InventoryRobot& b) { return a.id < b.id; });
  return inventory;
}

}  // namespace rips::bundle
