// sensor.yaml.
#ifndef RIPS_SENSOR_AGENT_CONFIG_H_
#define RIPS_SENSOR_AGENT_CONFIG_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "sensor_agent/ids/ids_feed.h"
#include "services/ros2/graph_limits.h"
#include "services/runtime/config_reader.h"
#include "services/runtime/config_sections.h"

namespace rips::sensor {

struct SensorConfig {
  // Must equal what the certificate says.
  std::string robot;
  std::string host;
  // host:port, tried in turn.
  std::vector<std::string> servers;
  TlsFiles tls;
  DdsSettings dds;
  // Without node `/rips` in the graph.
  bool observer_hidden = false;
  absl::Duration settle = absl::Seconds(2);
  absl::Duration attribution_grace = absl::Milliseconds(500);
  // What the graph may hold; `topics` is the server's to keep.
  ros2::GraphLimits graph_limits;
  // ROS topics whose messages are not read.
  std::vector<std::string> unwatched = {"/rosout", "/parameter_events"};
  // ROS topics that programs without a node may read: that is no finding.
  std::vector<std::string> raw_readers;
  std::string state_dir = "/var/lib/rips/sensor";
  ByteSize outbox_memory = {int64_t{64} << 20};
  // What is not acknowledged goes on in `spool_dir` when memory is short or the process ends; 0 =
  // never.
  ByteSize outbox_disk = {int64_t{256} << 20};
  // `spool` in state_dir, unless the file says otherwise; empty = no spool.
  std::string spool_dir;
  // Logs of the host's intrusion detection system.
  std::vector<IdsLog> ids;
  // rips-wire reports what is on the wire; this is where.
  bool wire = false;
  std::string wire_socket = "/run/rips/wire.sock";
  // SIGUSR1 and SIGUSR2 are reported.
  bool signals = true;
  std::string metrics = "127.0.0.1:9465";
  // All of this as it was read, defaults included.
  std::vector<ConfigSetting> settings;

  friend bool operator==(const SensorConfig&, const SensorConfig&) = default;
};

// `file` is the name used in messages. InvalidArgument with every problem and its place.
absl::StatusOr<SensorConfig> ParseSensorConfig(absl::string_view file, absl::string_view text);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_CONFIG_H_
