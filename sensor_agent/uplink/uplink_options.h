// Options of Uplink, and the observations it sends.
#ifndef RIPS_SENSOR_AGENT_UPLINK_UPLINK_OPTIONS_H_
#define RIPS_SENSOR_AGENT_UPLINK_UPLINK_OPTIONS_H_

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/time/time.h"
#include "sensor_agent/outbox/observation.h"
#include "sensor_agent/outbox/outbox.h"
#include "sensor_agent/spool/backlog.h"
#include "sensor_agent/uplink/wire_encoder.h"
#include "services/rpc/bidi_client.h"

namespace rips::sensor {

// What was seen since the last Append, in order.
struct Observations {
  std::vector<GraphChange> graph;
  std::vector<MessageSeen> messages;
  std::vector<Loss> losses;
  std::vector<std::string> signals;
  // With the time they were seen.
  std::vector<ControlObservation> ids_alerts;
  std::vector<ControlObservation> findings;
  // The settled snapshot is among `graph`: messages may follow.
  bool settled = false;
};

struct UplinkOptions {
  std::vector<std::string> servers;
  rpc::CredentialsSource credentials;
  // See BidiClientOptions.
  std::function<void(const rpc::Peer&)> on_peer;
  std::string host;
  uint32_t domain = 0;
  // Interests are kept there, for the next start; empty = nowhere.
  std::string interest_file;
  // What the server's store held is kept there, likewise.
  std::string store_file;
  OutboxLimits outbox;
  EncoderLimits encoder;
  BacklogOptions backlog;
  // Of the backlog, so that a server that comes back is not flooded by its robots.
  uint64_t backlog_bytes_per_second = 512 * 1024;
  // What waits longer to be sent is not live any more.
  absl::Duration live = absl::Seconds(2);
  rpc::BackoffPolicy backoff = rpc::SensorBackoff();
  absl::Duration heartbeat = absl::Milliseconds(500);
};

// Kinds of traffic that may not be visible: the first without a tap; the next two never; the last
// without DDS Security.
inline constexpr char kUnicastOnlyWriters[] = "unicast-only writers";
inline constexpr char kServiceRequests[] = "service requests";
inline constexpr char kSharedMemory[] = "participants that speak shared memory alone";
inline constexpr char kSecuredParticipants[] = "participants with DDS Security";

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_UPLINK_OPTIONS_H_
