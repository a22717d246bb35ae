#include "sensor_agent/daemon.h"

#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "sensor_agent/agent.h"
#include "sensor_agent/config.h"
#include "sensor_agent/host_metrics.h"
#include "sensor_agent/server_settings.h"
#include "services/base/status_macros.h"
#include "services/dds/address_watch.h"
#include "services/dds/host_addresses.h"
#include "services/dds/participant.h"
#include "services/dds/security.h"
#include "services/model/dds_problem.h"
#include "services/rpc/certificate_monitor.h"
#include "services/rpc/credentials.h"
#include "services/runtime/await.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/log.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"
#include "services/runtime/needed_directories.h"
#include "services/runtime/output_stream.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/service_manager.h"
#include "services/runtime/shutdown.h"
#include "services/runtime/ticker.h"

namespace rips::sensor {

namespace {

// How soon the policy server's settings, and other addresses of the host, are followed.
constexpr absl::Duration kLook = absl::Seconds(1);
// How often the settings are, at most.
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

// Keeps DDS on the addresses that the host has. Outlives the agents of one run.
class DdsAddresses {
 public:
  explicit DdsAddresses(const DdsSettings& dds)
      : domain_({.id = dds.domain, .interface = dds.interface}),
        watch_(dds::OperatorsOwnConfiguration() ? "" : dds.interface) {}

  // Before `sensor` is started.
  void Begun(Agent& sensor) {
    said_.clear();
    Say(sensor);
    if (sensor.no_domain().ok()) return;
    LogError("sees nothing on DDS; waiting for a network interface",
             {{"error", sensor.no_domain().message()}});
  }
  // About once a second. True if the sensor is to begin again.
  bool Poll(Agent& sensor) {
    const auto host = dds::HostAddresses();
    if (!host.ok()) return false;
    const int64_t now_ns = BoottimeNs();
    if (!sensor.no_domain().ok()) {
      if (!watch_.MayBegin(*host, now_ns) || !dds::TryDomain(domain_).ok()) return false;
      LogInfo("there is a network interface for DDS; beginning to watch");
      return true;
    }
    const bool again = watch_.Look(sensor.interfaces(), *host, now_ns);
    if (again) LogWarning("DDS begins again on other addresses", {{"change", watch_.change()}});
    if (!again && sensor.sees_robot()) watch_.SeenAgain();
    Say(sensor);
    return again;
  }

 private:
  void Say(Agent& sensor) {
    std::string why(sensor.no_domain().message());
    if (!watch_.problem().empty()) why = absl::StrCat(model::kDdsBeginsAgain, watch_.problem());
    if (why == said_) return;
    said_ = why;
    sensor.SayDdsProblem(said_);
  }

  const dds::DomainOptions domain_;
  dds::AddressWatch watch_;
  std::string said_;
};

// Why a watch ended.
enum class End { kSignal, kSettings, kAddresses };

End WaitForEnd(SignalWaiter& signals, Following& following, DdsAddresses& addresses,
               Agent& sensor) {
  while (!signals.WaitForShutdown(kLook)) {
    if (following.Poll(sensor)) return End::kSettings;
    if (addresses.Poll(sensor)) return End::kAddresses;
  }
  return End::kSignal;
}

// Of one agent, until it has stopped. An exit code if the ready file cannot be written.
absl::StatusOr<End> Watch(const DaemonFlags& flags, const SensorConfig& config, Agent& sensor,
                          SignalWaiter& signals, Metrics& metrics, ServiceManager& manager,
                          Following& following, DdsAddresses& addresses) {
  HostMetrics host({.disk = config.state_dir}, &metrics);
  host.Start();
  addresses.Begun(sensor);
  sensor.Start([&manager] { manager.Ping(); });
  LogInfo("watching", {{"robot", config.robot},
                       {"host", config.host},
                       {"domain", config.dds.domain},
                       {"participant", ToString(sensor.participant())}});
  RIPS_RETURN_IF_ERROR(WriteReadyFile(flags, "ready"));
  manager.Ready();
  End end = End::kSignal;
  {
    const Ticker status(absl::ZeroDuration(), [&] {
      manager.SetStatus(Describe(config, sensor));
      return ServiceManager::kStatusEvery;
    });
    end = WaitForEnd(signals, following, addresses, sensor);
  }
  if (end == End::kSettings) {
    LogInfo("the policy server has changed this sensor's settings; beginning to watch anew");
  } else if (end == End::kSignal) {
    manager.Stopping();
    LogInfo("stopping", {{"signal", signals.WaitForShutdown()}});
  }
  sensor.Stop();
  return end;
}

// The agent that runs, for threads that do not know when it goes.
class Running {
 public:
  void Set(Agent* sensor) {
    MutexLock lock(&mu_);
    sensor_ = sensor;
  }
  absl::Status Ready() const {
    MutexLock lock(&mu_);
    if (sensor_ == nullptr)
      return absl::UnavailableError("beginning, or waiting for the DDS keystore");
    RIPS_RETURN_IF_ERROR(sensor_->no_domain());
    return sensor_->Ready();
  }
  void OnSignal(const char* name) {
    MutexLock lock(&mu_);
    if (sensor_ != nullptr) sensor_->OnSignal(name);
  }

 private:
  mutable Mutex mu_;
  Agent* sensor_ ABSL_GUARDED_BY(mu_) = nullptr;
};

// Nullopt: the policy server's settings have changed; else the exit code.
std::optional<int> Serve(const DaemonFlags& flags, const SensorConfig& config,
                         const rpc::CredentialsSource& credentials, ServiceManager& manager,
                         Following& following) {
  const RealClock clock;
  Metrics metrics;
  rpc::CertificateMonitor monitor({.own = config.tls}, &clock, &metrics);
  Running running;  // before what calls it
  SignalWaiter::Callbacks callbacks;
  if (config.watch.signals) {
    callbacks[SIGUSR1] = [&running] { running.OnSignal("SIGUSR1"); };
    callbacks[SIGUSR2] = [&running] { running.OnSignal("SIGUSR2"); };
  }
  auto pages = MetricsPage::Start(config.metrics, &metrics, [&running] { return running.Ready(); });
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
  LogInfo("listening", {{"address", (*pages)->address()}});
  DdsAddresses addresses(config.dds);
  while (true) {
    auto agent = Agent::Create(config, credentials, &clock, &metrics, &monitor,
                               [&following](std::vector<ConfigSetting> settings) {
                                 following.Offer(std::move(settings));
                               });
    if (!agent.ok()) return Fail(kExitFailed, "cannot begin to watch", agent.status());
    running.Set(agent->get());
    const absl::StatusOr<End> end =
        Watch(flags, config, **agent, signals, metrics, manager, following, addresses);
    running.Set(nullptr);
    if (!end.ok()) return Fail(kExitFailed, "cannot write the ready file", end.status());
    if (*end == End::kSignal) return 0;
    if (*end == End::kSettings) return std::nullopt;
  }
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
  auto notify = ServiceManager::FromEnvironment();
  if (!flags.check_config) StartLogWriter();
  ServiceManager manager(std::move(notify));
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
    const std::optional<int> code = Serve(flags, config, credentials, manager, following);
    if (code.has_value()) return *code;
  }
}

}  // namespace rips::sensor
