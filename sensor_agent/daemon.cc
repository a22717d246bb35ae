#include "sensor_agent/daemon.h"

#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "sensor_agent/agent.h"
#include "sensor_agent/config.h"
#include "sensor_agent/host_metrics.h"
#include "sensor_agent/server_settings.h"
#include "services/base/status_macros.h"
#include "services/dds/participant.h"
#include "services/dds/security.h"
#include "services/rpc/certificate_monitor.h"
#include "services/rpc/credentials.h"
#include "services/runtime/await.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/log.h"
#include "services/runtime/metrics.h"
#include "services/runtime/needed_directories.h"
#include "services/runtime/output_stream.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/service_manager.h"
#include "services/runtime/shutdown.h"
#include "services/runtime/ticker.h"

namespace rips::sensor {

namespace {

// How soon the policy server's settings are followed, and how often at most.
constexpr absl::Duration kSettingsLook = absl::Seconds(1);
constexpr int64_t kSettingsPauseNs = 60 * kNanosPerSecond;

int64_t BoottimeNs() { return RealClock().Now().boottime_ns; }

// What a peer says about itself grants nothing, so a configuration that contradicts the certificate
// would be refused by the server; it is better to say so here.
absl::Status CheckIdentity(const SensorConfig& config, const rpc::PeerIdentity& self) {
  const bool same =
      self.role == rpc::Role::kSensor && self.robot == config.robot && self.host == config.host;
  if (same) return absl::OkStatus();
  return absl::PermissionDeniedError(
      absl::StrCat("certificate `", config.tls.cert, "` is of `", rpc::ToString(self),
                   "`, but the configuration says robot `", config.robot, "`, host `", config.host,
                   "`; use the certificate of this sensor"));
}

int Fail(int exit_code, absl::string_view doing, const absl::Status& status) {
  LogError(doing, {{"error", status.message()}});
  return exit_code;
}

// For `systemctl status`.
std::string Describe(const SensorConfig& config, const Agent& sensor) {
  const absl::Status ready = sensor.Ready();
  return absl::StrCat(
      "watching domain ", config.dds.domain, " of robot ", config.robot, "; ",
      ready.ok() ? "connected to the policy server" : "not connected: ", ready.message());
}

struct OwnFile {
  std::string path;
  std::string text;  // valid
};

// The policy server's settings, and what a run of the sensor follows of them.
class Following {
 public:
  // Begins nothing anew before CLOCK_BOOTTIME `not_before_ns`.
  Following(const OwnFile& file, ServerSettings* settings, int64_t not_before_ns)
      : file_(file),
        settings_(*settings),
        followed_(settings_.Get()),
        config_(Configure(followed_)),
        not_before_ns_(not_before_ns) {
    LogRefused();
  }

  const SensorConfig& config() const { return config_; }
  // Any thread.
  void Offer(std::vector<ConfigSetting> offered) { settings_.Offer(std::move(offered)); }
  // True if the sensor is to begin anew. Where its file lets the server change nothing of what has
  // changed, it only says so.
  bool Poll(Agent& sensor) {
    if (!settings_.Differ(followed_)) {
      waiting_ = false;
      return false;
    }
    std::vector<ConfigSetting> offered = settings_.Get();
    SensorConfig next = Configure(offered);
    if (next.watch == config_.watch) {
      followed_ = std::move(offered);
      config_ = std::move(next);
      sensor.SayConfiguration(config_.settings, config_.refused);
      LogRefused();
      return false;
    }
    const int64_t left_ns = not_before_ns_ - BoottimeNs();
    if (left_ns > 0 && !std::exchange(waiting_, true)) {
      LogInfo("the policy server has changed this sensor's settings again; following them later",
              {{"seconds", left_ns / kNanosPerSecond + 1}});
    }
    return left_ns <= 0;
  }

 private:
  SensorConfig Configure(const std::vector<ConfigSetting>& settings) const {
    return *ParseSensorConfig(file_.path, file_.text, settings);
  }
  void LogRefused() const {
    for (const std::string& refused : config_.refused) {
      LogWarning("not following a setting of the policy server", {{"error", refused}});
    }
  }

  const OwnFile& file_;
  ServerSettings& settings_;
  std::vector<ConfigSetting> followed_;
  SensorConfig config_;
  const int64_t not_before_ns_;
  bool waiting_ = false;
};

// Nullopt: the policy server's settings have changed.
std::optional<int> WaitForEnd(SignalWaiter& signals, Following& following, Agent& sensor) {
  while (!signals.WaitForShutdown(kSettingsLook)) {
    if (following.Poll(sensor)) return std::nullopt;
  }
  return signals.WaitForShutdown();
}

// As WaitForEnd, with the exit code.
std::optional<int> Watch(const DaemonFlags& flags, const SensorConfig& config, Agent& sensor,
                         SignalWaiter& signals, Metrics& metrics, ServiceManager& manager,
                         Following& following) {
  HostMetrics host({.disk = config.state_dir}, &metrics);
  host.Start();
  sensor.Start([&manager] { manager.Ping(); });
  LogInfo("watching", {{"robot", config.robot},
                       {"host", config.host},
                       {"domain", config.dds.domain},
                       {"participant", ToString(sensor.participant())}});
  if (absl::Status written = WriteReadyFile(flags, "ready"); !written.ok()) {
    return Fail(kExitFailed, "cannot write the ready file", written);
  }
  manager.Ready();
  std::optional<int> signal;
  {
    const Ticker status(absl::ZeroDuration(), [&] {
      manager.SetStatus(Describe(config, sensor));
      return ServiceManager::kStatusEvery;
    });
    signal = WaitForEnd(signals, following, sensor);
  }
  if (!signal.has_value()) {
    LogInfo("the policy server has changed this sensor's settings; beginning to watch anew");
    sensor.Stop();
    return std::nullopt;
  }
  manager.Stopping();
  LogInfo("stopping", {{"signal", *signal}});
  sensor.Stop();
  return 0;
}

// As Watch.
std::optional<int> Serve(const DaemonFlags& flags, const SensorConfig& config,
                         rpc::CredentialsSource credentials, ServiceManager& manager,
                         Following& following) {
  const RealClock clock;
  Metrics metrics;
  rpc::CertificateMonitor monitor({.own = config.tls}, &clock, &metrics);
  std::atomic<Agent*> running = nullptr;
  SignalWaiter::Callbacks callbacks;
  if (config.watch.signals) {
    const auto tell = [&running](const char* name) {
      if (Agent* sensor = running) sensor->OnSignal(name);
    };
    callbacks[SIGUSR1] = [tell] { tell("SIGUSR1"); };
    callbacks[SIGUSR2] = [tell] { tell("SIGUSR2"); };
  }
  std::unique_ptr<Agent> agent;  // before what calls it
  auto pages = MetricsPage::Start(config.metrics, &metrics, [&running] {
    const Agent* sensor = running;
    return sensor == nullptr ? absl::UnavailableError("waiting for the DDS keystore")
                             : sensor->Ready();
  });
  if (!pages.ok()) return Fail(kExitConfig, "cannot serve metrics", pages.status());
  SignalWaiter signals(std::move(callbacks));
  const absl::Status awaited = Await(
      "the DDS keystore",
      [&]() -> absl::Status {
        const auto enclave = dds::LoadSecurity(config.dds, absl::Now());
        if (enclave.ok()) return absl::OkStatus();
        // The robot's start must not wait for it.
        manager.Ready();
        manager.SetStatus(absl::StrCat("sees nothing: waiting for the DDS keystore: ",
                                       enclave.status().message()));
        // PermissionDenied of a file may pass, too.
        return absl::UnavailableError(enclave.status().message());
      },
      [&](absl::Duration pause) {
        manager.Ping();
        return signals.WaitForShutdown(pause);
      });
  if (!awaited.ok()) return 0;  // told to end
  auto created = Agent::Create(
      config, std::move(credentials), &clock, &metrics, &monitor,
      [&following](std::vector<ConfigSetting> settings) { following.Offer(std::move(settings)); });
  if (!created.ok()) return Fail(kExitFailed, "cannot begin to watch", created.status());
  agent = *std::move(created);
  running = agent.get();
  LogInfo("listening", {{"address", (*pages)->address()}});
  const std::optional<int> code =
      Watch(flags, config, *agent, signals, metrics, manager, following);
  running = nullptr;
  return code;
}

// --check-config: of the files that the configuration names, too.
int CheckConfig(const std::string& file, const SensorConfig& config) {
  std::vector<NeededDirectory> needed = {{"state_dir", ParentDirectory(config.state_dir)}};
  const std::string spool = ParentDirectory(config.spool_dir);
  const bool with_state = spool == ParentDirectory(absl::StrCat(config.state_dir, "/spool"));
  if (config.watch.outbox_disk.bytes > 0 && !with_state) needed.push_back({"outbox.dir", spool});
  if (const absl::Status there = CheckDirectories(file, needed); !there.ok()) {
    std::fprintf(stderr, "%s\n", std::string(there.message()).c_str());
    return kExitConfig;
  }
  if (const auto enclave = dds::LoadSecurity(config.dds, absl::Now()); !enclave.ok()) {
    return Fail(kExitConfig, "cannot use the keystore", enclave.status());
  }
  std::string certificate;
  const absl::Status mine = rpc::CheckOwn(
      config.tls, [&](const rpc::PeerIdentity& self) { return CheckIdentity(config, self); },
      &certificate);
  if (!mine.ok()) return Fail(kExitConfig, "wrong certificate", mine);
  const absl::Status interface = dds::FindInterface(config.dds.interface);
  OutputStream out(STDOUT_FILENO);
  out << FormatSettings(config.settings);
  // What may come before the daemon starts.
  std::vector<std::string> warnings = config.refused;
  warnings.push_back(certificate);
  warnings.emplace_back(interface.message());
  PrintWarnings(warnings);
  return out.End(0);
}

}  // namespace

int RunDaemon(const DaemonFlags& flags) {
  ServiceManager manager(ServiceManager::FromEnvironment());
  const absl::StatusOr<std::string> text = ReadConfigFile(flags.config);
  if (!text.ok()) return Fail(kExitConfig, "cannot read the configuration", text.status());
  const absl::StatusOr<SensorConfig> own = ParseSensorConfig(flags.config, *text);
  if (!own.ok()) {
    std::fprintf(stderr, "%s\n", std::string(own.status().message()).c_str());
    return kExitConfig;
  }
  const OwnFile file{.path = flags.config, .text = *text};
  ServerSettings from_server(ServerSettingsFile(own->state_dir));
  if (flags.check_config) {
    return CheckConfig(flags.config,
                       *ParseSensorConfig(flags.config, file.text, from_server.Get()));
  }
  for (int64_t not_before_ns = 0;; not_before_ns = BoottimeNs() + kSettingsPauseNs) {
    Following following(file, &from_server, not_before_ns);
    const SensorConfig config = following.config();
    rpc::CredentialsSource credentials(config.tls);
    credentials.Require(
        [&config](const rpc::PeerIdentity& self) { return CheckIdentity(config, self); });
    // Whatever else is wrong with them may pass: what is seen meanwhile is kept.
    if (const absl::Status mine = credentials.Get().status(); absl::IsPermissionDenied(mine)) {
      return Fail(kExitConfig, "wrong certificate", mine);
    }
    const std::optional<int> code =
        Serve(flags, config, std::move(credentials), manager, following);
    if (code.has_value()) return *code;
  }
}

}  // namespace rips::sensor
