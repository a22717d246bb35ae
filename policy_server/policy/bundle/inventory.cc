#include "policy_server/policy/bundle/inventory.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "absl/container/btree_set.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/model_proto/configuration_codec.h"
#include "services/runtime/config_reader.h"
#include "services/runtime/config_sections.h"
#include "services/sensor_settings/sensor_settings.h"
#include "services/text/quote.h"

namespace rips::bundle {
namespace {

// What the sensors of a robot are sent, which they hold with a few bytes more for each.
constexpr size_t kSensorSettingsBytesMax = model_proto::kConfigurationBytesMax / 4 * 3;

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

void ReadLabels(const ConfigSection& parent, absl::btree_map<std::string, std::string>* labels) {
  const ConfigSection section = parent.OptionalSection("labels");
  const std::vector<std::string> keys = section.Keys();
  CheckCount(parent, "labels", keys.size(), kLabelsMax);
  for (const std::string& key : keys) {
    if (const absl::Status valid = ValidateName("label", key); !valid.ok()) {
      section.Problem(key, valid.message());
    }
    ReadName(section, key, "value of a label", &(*labels)[key]);
  }
}

// Labels of an entry that holds for all robots with them.
void ReadEntryLabels(const ConfigSection& entry,
                     absl::btree_map<std::string, std::string>* labels) {
  ReadLabels(entry, labels);
  if (!entry.Has("labels") || !labels->empty()) return;
  entry.Problem("labels", "`labels` has none; leave it out for an entry that fits all robots");
}

void ReadLabelBundles(const ConfigSection& root, absl::string_view file,
                      std::vector<LabelBundle>* bundles) {
  for (const ConfigSection& section : root.Sections("bundles")) {
    LabelBundle& added = bundles->emplace_back();
    ReadEntryLabels(section, &added.labels);
    ReadName(section, "bundle", "bundle name", &added.bundle);
    added.source = absl::StrCat(file, ":", section.LineOf("bundle"));
  }
  CheckCount(root, "bundles", bundles->size(), kLabelEntriesMax);
}

void ReadLabelSettings(const ConfigSection& root, absl::string_view file,
                       std::vector<LabelSettings>* all) {
  for (const ConfigSection& section : root.Sections("sensor_settings")) {
    LabelSettings& added = all->emplace_back();
    ReadEntryLabels(section, &added.labels);
    added.source = absl::StrCat(file, ":", section.LineOf("set"));
    const ConfigSection set = section.RequiredSection("set");
    if (set.present() && set.Keys().empty()) {
      section.Problem("set", absl::StrCat("`set` is empty; it may have `",
                                          absl::StrJoin(SettableNames(), "`, `"), "`"));
    }
    SensorSettings valid;
    ReadSensorSettings(set, valid);
  }
  CheckCount(root, "sensor_settings", all->size(), kLabelEntriesMax);
}

// `PREFIX[I].PATH` as I and PATH, if I is below `count`.
std::optional<std::pair<size_t, absl::string_view>> SplitPath(absl::string_view path,
                                                              absl::string_view prefix,
                                                              size_t count) {
  if (!absl::ConsumePrefix(&path, prefix) || !absl::ConsumePrefix(&path, "[")) return std::nullopt;
  const size_t end = path.find("].");
  size_t index = 0;
  if (end == path.npos || !absl::SimpleAtoi(path.substr(0, end), &index) || index >= count) {
    return std::nullopt;
  }
  return std::pair(index, path.substr(end + 2));
}

// What entries of `sensor_settings` set, as the text has it.
absl::Status AddLabelSettings(const std::vector<ConfigSetting>& settings,
                              std::vector<LabelSettings>& all) {
  for (const ConfigSetting& each : settings) {
    const auto split = SplitPath(each.path, "sensor_settings", all.size());
    if (!split.has_value() || each.source.empty()) continue;
    absl::string_view path = split->second;
    if (!absl::ConsumePrefix(&path, "set.")) continue;
    if (each.value.size() > model_proto::kSettingTextBytesMax) {
      return absl::InvalidArgumentError(absl::StrCat(each.source, ": `", path, "` has ",
                                                     each.value.size(), " bytes; at most ",
                                                     model_proto::kSettingTextBytesMax));
    }
    all[split->first].settings.push_back(
        {.path = std::string(path), .value = each.value, .source = each.source});
  }
  return absl::OkStatus();
}

// Those of `robots[I].PATH` as PATH, by the I-th of `robots`.
void AddSettings(const std::vector<ConfigSetting>& settings,
                 const std::vector<InventoryRobot>& robots, Inventory& inventory) {
  for (const ConfigSetting& each : settings) {
    const auto split = SplitPath(each.path, "robots", robots.size());
    if (!split.has_value()) continue;
    inventory.settings[robots[split->first].id].push_back(
        {.path = std::string(split->second), .value = each.value, .source = each.source});
  }
}

bool Fits(const absl::btree_map<std::string, std::string>& labels, const InventoryRobot& robot) {
  return std::all_of(labels.begin(), labels.end(), [&](const auto& label) {
    const auto found = robot.labels.find(label.first);
    return found != robot.labels.end() && found->second == label.second;
  });
}

absl::Status AssignBundles(Inventory& inventory) {
  const auto for_all = std::find_if(inventory.bundles.begin(), inventory.bundles.end(),
                                    [](const LabelBundle& each) { return each.labels.empty(); });
  if (for_all != inventory.bundles.end() && for_all + 1 != inventory.bundles.end()) {
    return absl::InvalidArgumentError(
        absl::StrCat("of `bundles`, the entry without labels for `", for_all->bundle,
                     "` is not the last: those after it would never fit a robot"));
  }
  std::vector<std::string> without;
  for (InventoryRobot& robot : inventory.robots) {
    if (!robot.bundle.empty()) continue;
    const auto entry =
        std::find_if(inventory.bundles.begin(), inventory.bundles.end(),
                     [&](const LabelBundle& each) { return Fits(each.labels, robot); });
    if (entry == inventory.bundles.end()) {
      without.push_back(absl::StrCat("`", robot.id, "`"));
    } else {
      robot.bundle = entry->bundle;
      inventory.settings[robot.id].push_back({.path = "bundle",
                                              .value = absl::StrCat("\"", entry->bundle, "\""),
                                              .source = entry->source});
    }
  }
  if (without.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("without `bundle`, and no entry of `bundles` has labels that fit: robot ",
                   absl::StrJoin(without, ", "), "; give it a `bundle: NAME`, or add an entry"));
}

absl::Status AssignSensorSettings(Inventory& inventory) {
  for (const LabelSettings& entry : inventory.sensor_settings) {
    const bool fits = std::any_of(inventory.robots.begin(), inventory.robots.end(),
                                  [&](const auto& robot) { return Fits(entry.labels, robot); });
    if (fits) continue;
    inventory.warnings.push_back(
        absl::StrCat(entry.source, ": no robot has the labels of this entry of `sensor_settings`"));
  }
  for (InventoryRobot& robot : inventory.robots) {
    absl::btree_set<absl::string_view> set;
    size_t bytes = 0;
    for (const LabelSettings& entry : inventory.sensor_settings) {
      if (!Fits(entry.labels, robot)) continue;
      for (const ConfigSetting& each : entry.settings) {
        if (!set.insert(each.path).second) continue;
        bytes += each.path.size() + each.value.size() + each.source.size();
        robot.sensor_settings.push_back(each);
        inventory.settings[robot.id].push_back({.path = absl::StrCat("sensor_settings.", each.path),
                                                .value = each.value,
                                                .source = each.source});
      }
    }
    if (bytes > kSensorSettingsBytesMax) {
      return absl::InvalidArgumentError(absl::StrCat("`sensor_settings` of robot `", robot.id,
                                                     "` have ", bytes, " bytes; at most ",
                                                     kSensorSettingsBytesMax));
    }
  }
  return absl::OkStatus();
}

}  // namespace

bool InventoryRobot::HasLabel(absl::string_view label) const {
  const auto parsed = ParseLabel(label);
  if (!parsed.ok()) return false;
  const auto found = labels.find(parsed->first);
  return found != labels.end() && found->second == parsed->second;
}

absl::StatusOr<std::pair<std::string, std::string>> ParseLabel(absl::string_view label) {
  const size_t equals = label.find('=');
  if (equals == label.npos) {
    return absl::InvalidArgumentError(absl::StrCat(
        QuoteBytes(label), " is not a label; write KEY=VALUE, for example `ring=canary`"));
  }
  const absl::string_view key = label.substr(0, equals);
  const absl::string_view value = label.substr(equals + 1);
  RIPS_RETURN_IF_ERROR(ValidateName("label", key));
  RIPS_RETURN_IF_ERROR(ValidateName("value of a label", value));
  return std::pair(std::string(key), std::string(value));
}

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
  const bool has_something =
      root.Has("robots") || root.Has("bundles") || root.Has("sensor_settings");
  if (root.present() && !has_something) root.Problem("robots", "missing key `robots`");
  ReadLabelBundles(root, file, &inventory.bundles);
  ReadLabelSettings(root, file, &inventory.sensor_settings);
  for (const ConfigSection& section : root.Sections("robots")) {
    InventoryRobot robot;
    ReadName(section, "id", "robot id", &robot.id);
    if (section.Has("bundle")) ReadName(section, "bundle", "bundle name", &robot.bundle);
    ReadSensors(section, &robot.sensors);
    ReadActuators(section, &robot.actuators);
    ReadGraphLimits(section.OptionalSection("graph_limits"), robot.graph_limits);
    ReadLabels(section, &robot.labels);
    if (!robot.id.empty() && !ids.insert(robot.id).second) {
      section.Problem("id", absl::StrCat("robot `", robot.id, "` is listed twice"));
    }
    inventory.robots.push_back(std::move(robot));
  }
  CheckCount(root, "robots", inventory.robots.size(), kRobotsMax);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  RIPS_RETURN_IF_ERROR(AddLabelSettings(reader.Settings(), inventory.sensor_settings));
  AddSettings(reader.Settings(), inventory.robots, inventory);
  std::sort(inventory.robots.begin(), inventory.robots.end(),
            [](const InventoryRobot& a, const InventoryRobot& b) { return a.id < b.id; });
  return inventory;
}

absl::Status AssignByLabels(Inventory& inventory) {
  for (const auto& [key, count] :
       {std::pair("bundles", inventory.bundles.size()),
        std::pair("sensor_settings", inventory.sensor_settings.size())}) {
    if (count <= kLabelEntriesMax) continue;
    return absl::InvalidArgumentError(
        absl::StrCat(count, " `", key, "` exceed limit ", kLabelEntriesMax));
  }
  RIPS_RETURN_IF_ERROR(AssignBundles(inventory));
  return AssignSensorSettings(inventory);
}

}  // namespace rips::bundle
