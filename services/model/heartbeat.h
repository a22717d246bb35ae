// How often an agent and the policy server send each other heartbeats.
#ifndef RIPS_SERVICES_MODEL_HEARTBEAT_H_
#define RIPS_SERVICES_MODEL_HEARTBEAT_H_

#include <algorithm>
#include <cstdint>

#include "services/base/clock.h"

namespace rips::model {

// Until the server has set an interval on this stream, and with a server that sets none.
inline constexpr int64_t kHeartbeatNs = 500 * kNanosPerMilli;
// What `timing.heartbeat` of the server may be.
inline constexpr int64_t kHeartbeatNsMin = 50 * kNanosPerMilli;
inline constexpr int64_t kHeartbeatNsMax = 10 * kNanosPerSecond;

// The interval that `wire_ms` (SensorConfig.heartbeat_ms, Lease.heartbeat_ms) sets; 0 sets none.
inline int64_t HeartbeatIntervalNs(uint32_t wire_ms, int64_t otherwise_ns = kHeartbeatNs) {
  if (wire_ms == 0) return otherwise_ns;
  return std::clamp(wire_ms * kNanosPerMilli, kHeartbeatNsMin, kHeartbeatNsMax);
}

}  // namespace rips::model

#endif  // RIPS_SERVICES_MODEL_HEARTBEAT_H_
