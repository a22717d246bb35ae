#include "sensor_agent/daemon.h"

#include <csignal>
#include <cstdio>
#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "sensor_agent/agent.h"
#include "sensor_agent/config.h"
#include "sensor_agent/host_metrics.h"
#include "services/base/status_macros.h"
#include "services/dds/security.h"
#include "services/rpc/credentials.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/log.h"
#include "services/runtime/metrics.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/shutdown.h"

namespace rips::sensor {

namespace {

// What a peer says about itself grants nothing, so a configuration that contradicts the certificate
// would be refused by the server; it is better to say so here.
absl::Status CheckIdentity(const SensorConfig& config, const rpc::PeerIdentity& self) {
  const bool same =
      self.role == rpc::Role::kSensor && self.robot == config.robot && self.host == config.host;
  if (same) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("certificate `", config.tls.cert, "` is of `", rpc::ToString(self),
                   "`, but the configuration says robot `", config.robot, "`, host `", config.host,
                   "`; use the certificate of this sensor"));
}

int Fail(int exit_code, absl::string_view doing, const absl::Status& status) {
  LogError(doing, {{"error", status.message()}});
  return exit_code;
}

int Serve(const DaemonFlags& flags, const SensorConfig& config,
          std::shared_ptr<grpc::ChannelCredentials> credentials) {
  const RealClock clock;
  Metrics metrics;
  absl::StatusOr<std::unique_ptr<Agent>> agent =
      Agent::Create(config, std::move(credentials), &clock, &metrics);
  if (!agent.ok()) return Fail(kExitFailed, "cannot begin to watch", agent.status());
  Agent& sensor = **agent;
  auto pages = MetricsServer::Start(config.metrics, &metrics, [&] { return sensor.Ready(); });
  if (!pages.ok()) return Fail(kExitFailed, "cannot serve metrics", pages.status());
  SignalWaiter::Callbacks callbacks;
  if (config.signals) {
    callbacks[SIGUSR1] = [&] { sensor.OnSignal("SIGUSR1"); };
    callbacks[SIGUSR2] = [&] { sensor.OnSignal("SIGUSR2"); };
  }
  SignalWaiter signals(std::move(callbacks));
  HostMetrics host({.disk = config.state_dir}, &metrics);
  host.Start();
  sensor.Start();
  LogInfo("watching", {{"robot", config.robot},
                       {"host", config.host},
                       {"domain", config.dds.domain},
                       {"participant", ToString(sensor.participant())}});
  LogInfo("listening", {{"address", (*pages)->address()}});
  if (absl::Status written = WriteReadyFile(flags, "ready"); !written.ok()) {
    return Fail(kExitFailed, "cannot write the ready file", written);
  }
  const int signal = signals.WaitForShutdown();
  LogInfo("stopping", {{"signal", signal}});
  sensor.Stop();
  return 0;
}

}  // namespace

int RunDaemon(const DaemonFlags& flags) {
  const absl::StatusOr<std::string> text = ReadConfigFile(flags.config);
  if (!text.ok()) return Fail(kExitConfig, "cannot read the configuration", text.status());
  std::string effective;
  const absl::StatusOr<SensorConfig> config = ParseSensorConfig(flags.config, *text, &effective);
  if (!config.ok()) {
    std::fprintf(stderr, "%s\n", std::string(config.status().message()).c_str());
    return kExitConfig;
  }
  if (const auto enclave = dds::LoadSecurity(config->dds, absl::Now()); !enclave.ok()) {
    return Fail(kExitConfig, "cannot use the keystore", enclave.status());
  }
  if (flags.check_config) {
    std::fputs(effective.c_str(), stdout);
    return 0;
  }
  const auto credentials = rpc::Credentials::Load(config->tls);
  if (!credentials.ok())
    return Fail(kExitConfig, "cannot use the certificate", credentials.status());
  if (absl::Status same = CheckIdentity(*config, (*credentials)->self()); !same.ok()) {
    return Fail(kExitConfig, "wrong certificate", same);
  }
  return Serve(flags, *config, (*credentials)->ForClient());
}

}  // namespace rips::sensor
