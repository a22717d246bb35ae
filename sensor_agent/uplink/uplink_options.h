// Options of Uplink.
#ifndef RIPS_SENSOR_AGENT_UPLINK_UPLINK_OPTIONS_H_
#define RIPS_SENSOR_AGENT_UPLINK_UPLINK_OPTIONS_H_

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "sensor_agent/outbox/uplink_core.h"
#include "sensor_agent/spool/spool.h"
#include "sensor_agent/uplink/wire_encoder.h"
#include "services/base/config_setting.h"
#include "services/rpc/bidi_client.h"

namespace rips::sensor {

struct UplinkOptions {
  std::vector<std::string> servers;
  rpc::CredentialsSource credentials;
  // See BidiClientOptions.
  std::function<void(const rpc::Peer&)> on_peer;
  std::string host;
  uint32_t domain = 0;
  // Shown to operators: the configuration, and what is refused of the server's part of it.
  std::vector<ConfigSetting> settings;
  std::vector<std::string> refused;
  // Interests are kept there, for the next start; empty = nowhere.
  std::string interest_file;
  // What the server's store held is kept there, likewise.
  std::string store_file;
  UplinkCoreOptions core;
  // Empty dir or no disk_bytes: nothing is kept on disk.
  SpoolOptions spool = {.disk_bytes = 0};
  EncoderLimits encoder;
  rpc::BackoffPolicy backoff = rpc::SensorBackoff();
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_UPLINK_OPTIONS_H_
