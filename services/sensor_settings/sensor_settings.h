// How a sensor watches: the part of sensor.yaml that the policy server may set where the file
// allows it (`server_may_set`). Both ends read it here: the server refuses what a sensor would.
#ifndef RIPS_SERVICES_SENSOR_SETTINGS_SENSOR_SETTINGS_H_
#define RIPS_SERVICES_SENSOR_SETTINGS_SENSOR_SETTINGS_H_

#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/ros2/graph_limits.h"
#include "services/runtime/config_reader.h"

namespace rips {

struct SensorSettings {
  // Without node `/rips` in the graph.
  bool observer_hidden = false;
  // The graph is settled when nothing has changed for so long.
  absl::Duration settle = absl::Seconds(2);
  // A writer or reader may be without a node for so long.
  absl::Duration attribution_grace = absl::Milliseconds(500);
  // What the graph may hold; `topics` is the server's to keep.
  ros2::GraphLimits graph_limits;
  // ROS topics whose messages are not read.
  std::vector<std::string> unwatched = {"/rosout", "/parameter_events"};
  // ROS topics that programs without a node may read: that is no finding.
  std::vector<std::string> raw_readers;
  ByteSize outbox_memory = {int64_t{64} << 20};
  // What is not acknowledged goes on in the spool when memory is short or the process ends; 0 =
  // never.
  ByteSize outbox_disk = {int64_t{256} << 20};
  // SIGUSR1 and SIGUSR2 are reported.
  bool signals = true;

  friend bool operator==(const SensorSettings&, const SensorSettings&) = default;
};

// From the keys of `root`; other keys are not asked for.
void ReadSensorSettings(const ConfigSection& root, SensorSettings& settings);

// What `server_may_set` may list, `outbox.memory` and `graph_limits` among them.
const std::vector<std::string>& SettableNames();
// True if `path` is `name`, or below it: `graph_limits.nodes` is below `graph_limits`.
bool IsSettingOf(absl::string_view path, absl::string_view name);

}  // namespace rips

#endif  // RIPS_SERVICES_SENSOR_SETTINGS_SENSOR_SETTINGS_H_
