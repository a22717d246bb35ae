// sensor.yaml.
#ifndef RIPS_SENSOR_AGENT_CONFIG_H_
#define RIPS_SENSOR_AGENT_CONFIG_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
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
  // ROS topics whose messages are not read.
  std::vector<std::string> unwatched = {"/rosout", "/parameter_events"};
  std::string state_dir = "/var/lib/rips/sensor";
  ByteSize outbox_memory = {int64_t{64} << 20};
  // What is not acknowledged goes on in `spool_dir` when memory is short or the process ends; 0 =
  // never.
  ByteSize outbox_disk = {int64_t{256} << 20};
  // `spool` in state_dir, unless the file says otherwise; empty = no spool.
  std::string spool_dir;
  // SIGUSR1 and SIGUSR2 are reported.
  bool signals = true;
  std::string metrics = "127.0.0.1:9465";

  friend bool operator==(const SensorConfig&, const SensorConfig&) = default;
};

// `file` is the name used in messages. InvalidArgument with every problem and its place. What the
// format knows but this version does not do (ids, wire, DDS security) is a problem, too: a sensor
// must not pretend to see what it does not. `effective`, if not null, takes the effective
// configuration as text.
absl::StatusOr<SensorConfig> ParseSensorConfig(absl::string_view file, absl::string_view text,
                                               std::string* effective = nullptr);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_CONFIG_H_
