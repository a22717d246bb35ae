// sensor.yaml.
#ifndef RIPS_SENSOR_AGENT_CONFIG_H_
#define RIPS_SENSOR_AGENT_CONFIG_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "sensor_agent/ids/ids_feed.h"
#include "services/runtime/config_reader.h"
#include "services/runtime/config_sections.h"
#include "services/sensor_settings/sensor_settings.h"

namespace rips::sensor {

struct SensorConfig {
  // Must equal what the certificate says.
  std::string robot;
  std::string host;
  // host:port, tried in turn.
  std::vector<std::string> servers;
  TlsFiles tls;
  DdsSettings dds;
  SensorSettings watch;
  // Of SettableNames: what the policy server may set in place of this file.
  std::vector<std::string> server_may_set;
  std::string state_dir = "/var/lib/rips/sensor";
  // `spool` in state_dir, unless the file says otherwise; empty = no spool.
  std::string spool_dir;
  // Logs of the host's intrusion detection system.
  std::vector<IdsLog> ids;
  // rips-wire reports what is on the wire; this is where.
  bool wire = false;
  std::string wire_socket = "/run/rips/wire.sock";
  std::string metrics = "127.0.0.1:9465";
  // All of this as it was read, defaults included.
  std::vector<ConfigSetting> settings;
  // What the policy server set and this does not follow, and why.
  std::vector<std::string> refused;

  friend bool operator==(const SensorConfig&, const SensorConfig&) = default;
};

// `file` is the name used in messages. InvalidArgument with every problem of the text and where.
// `from_server` is what the policy server sets: followed as far as the text allows it, and only if
// all of that is valid.
absl::StatusOr<SensorConfig> ParseSensorConfig(absl::string_view file, absl::string_view text,
                                               const std::vector<ConfigSetting>& from_server = {});

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_CONFIG_H_
