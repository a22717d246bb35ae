#include "policy_server/server/outputs/outputs.h"

#include <random>
#include <string>
#include <utility>

#include "policy_server/server/outputs/syslog_receiver.h"
#include "policy_server/server/outputs/webhook_receiver.h"

namespace rips::outputs {
namespace {

std::unique_ptr<Receiver> MakeReceiver(const server::OutputConfig& config, const Clock* clock) {
  if (config.kind == server::OutputConfig::Kind::kSyslog) {
    return std::make_unique<SyslogReceiver>(config, Timeouts());
  }
  return std::make_unique<WebhookReceiver>(config, Timeouts(), clock);
}

OutputReports MakeReports(const std::string& name, Metrics* metrics,
                          const DeliveryHealth::Alert& alert) {
  const auto alerts = [&](const char* result) {
    const Counter made =
        metrics->AddCounter("rips_output_alerts_total",
                            "Alerts of an output that were sent, skipped because the receiver "
                            "refuses them, or forgotten by the store before they were sent.",
                            {{"output", name}, {"result", result}});
    return [made](uint64_t by) { made.Increment(static_cast<double>(by)); };
  };
  const Counter failures =
      metrics->AddCounter("rips_output_failures_total",
                          "Deliveries of an output that were not accepted.", {{"output", name}});
  const Gauge behind = metrics->AddGauge("rips_output_behind",
                                         "Sequences of alerts that an output is behind the store.",
                                         {{"output", name}});
  const Gauge healthy = metrics->AddGauge("rips_output_healthy",
                                          "1 while an output delivers alerts, 0 after a failure.",
                                          {{"output", name}});
  return {.sent = alerts("sent"),
          .skipped = alerts("skipped"),
          .forgotten = alerts("forgotten"),
          .failed = [failures] { failures.Increment(); },
          .behind = [behind](uint64_t by) { behind.Set(static_cast<double>(by)); },
          .healthy = [healthy](bool ok) { healthy.Set(ok ? 1 : 0); },
          .alert = alert};
}

}  // namespace

Outputs::Outputs(const std::vector<server::OutputConfig>& configs, store::Store* store,
                 Metrics* metrics, const Clock* clock, const DeliveryHealth::Alert& alert) {
  for (const server::OutputConfig& config : configs) {
    auto bits = std::make_shared<std::mt19937_64>(std::random_device()());
    outputs_.push_back(std::make_unique<Output>(
        config, store, MakeReceiver(config, clock), MakeReports(config.name, metrics, alert), clock,
        [bits] { return std::uniform_real_distribution<double>(0, 1)(*bits); }));
  }
}

Outputs::~Outputs() { Stop(); }

void Outputs::Stop() {
  // All at once, so that none waits for another.
  for (const auto& output : outputs_) output->Cancel();
  for (const auto& output : outputs_) output->Stop();
}

}  // namespace rips::outputs
