#include "sensor_agent/uplink/uplink_metrics.h"

#include <utility>

namespace rips::sensor {

UplinkMetrics::UplinkMetrics(Metrics* metrics)
    : batches(metrics->AddCounter("rips_sensor_batches_total", "Batches handed to the stream")),
      observations_sent(metrics->AddCounter("rips_sensor_observations_sent_total",
                                            "Observations sent, repeated ones included")),
      stream_ends(metrics->AddCounter("rips_sensor_stream_ends_total",
                                      "Streams and attempts to connect that ended")),
      shed(metrics->AddCounter("rips_sensor_shed_total", "Messages shed by a full outbox")),
      payloads_shed(metrics->AddCounter(
          "rips_sensor_payloads_shed_total",
          "Payloads that were asked for and not kept; their messages were, as metadata")),
      payload_bytes(metrics->AddCounter("rips_sensor_payload_bytes_total",
                                        "Bytes of payloads above 64 KiB sent in chunks")),
      spool_unreadable(metrics->AddCounter("rips_sensor_spool_lost_total",
                                           "Observations that the spool could not give back")),
      outbox_bytes(metrics->AddGauge("rips_sensor_outbox_bytes",
                                     "Estimated memory of observations not acknowledged")),
      backlog_bytes(metrics->AddGauge("rips_sensor_backlog_bytes",
                                      "Memory of observations set aside, in part on disk, too")),
      spool_bytes(metrics->AddGauge("rips_sensor_spool_bytes",
                                    "Observations on disk that are not acknowledged, bytes")),
      spool_refuses(metrics->AddGauge("rips_sensor_spool_refuses",
                                      "1 while the disk does not take what should be spooled")),
      oldest_unacked(metrics->AddGauge("rips_sensor_oldest_unacked_seconds",
                                       "Age of the oldest observation not acknowledged")),
      streaming(metrics->AddGauge("rips_sensor_streaming", "1 while the stream carries batches")),
      blind_reasons(
          metrics->AddGauge("rips_sensor_blind_reasons", "Configured inputs that are not seen")) {}

void UplinkMetrics::Update(const UplinkCore& core, int64_t now_ns) {
  const auto count = [](const Counter& counter, uint64_t now, uint64_t& counted) {
    counter.Increment(static_cast<double>(now - std::exchange(counted, now)));
  };
  const BacklogState backlog = core.backlog().state();
  count(shed, core.outbox().shed_messages(), shed_);
  count(payloads_shed, core.outbox().shed_payloads(), payloads_shed_);
  count(spool_unreadable, backlog.unreadable, unreadable_);
  outbox_bytes.Set(static_cast<double>(core.outbox().bytes()));
  backlog_bytes.Set(static_cast<double>(backlog.memory_bytes));
  spool_bytes.Set(static_cast<double>(core.backlog().disk().bytes));
  spool_refuses.Set(backlog.disk_refuses ? 1 : 0);
  const int64_t age_ns = now_ns - OldestUnacked(core.outbox(), backlog).value_or(now_ns);
  oldest_unacked.Set(static_cast<double>(age_ns) / kNanosPerSecond);
  streaming.Set(core.phase() == UplinkCore::Phase::kStreaming ? 1 : 0);
  blind_reasons.Set(static_cast<double>(core.status().blind().size()));
}

}  // namespace rips::sensor
