// The uplink's counters and gauges.
#ifndef RIPS_SENSOR_AGENT_UPLINK_UPLINK_METRICS_H_
#define RIPS_SENSOR_AGENT_UPLINK_UPLINK_METRICS_H_

#include <cstdint>

#include "sensor_agent/outbox/uplink_core.h"
#include "services/runtime/metrics.h"

namespace rips::sensor {

struct UplinkMetrics {
  explicit UplinkMetrics(Metrics* metrics);

  // What the core holds and has shed by now. Not thread-safe.
  void Update(const UplinkCore& core, int64_t now_ns);

  Counter batches;
  Counter observations_sent;
  Counter stream_ends;
  Counter shed;
  Counter payloads_shed;
  Counter payload_bytes;
  Counter spool_unreadable;
  Gauge outbox_bytes;
  Gauge backlog_bytes;
  Gauge spool_bytes;
  Gauge spool_refuses;
  Gauge oldest_unacked;
  Gauge streaming;
  Gauge blind_reasons;

 private:
  // As counted so far.
  uint64_t shed_ = 0;
  uint64_t payloads_shed_ = 0;
  uint64_t unreadable_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_UPLINK_METRICS_H_
