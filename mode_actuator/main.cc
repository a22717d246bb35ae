// rips-actuator: brings one robot host to the level the policy server decided, and keeps it safe
// when there is no server.
#include <unistd.h>

#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/time/clock.h"
#include "mode_actuator/link/agent.h"
#include "services/dds/address_watch.h"
#include "services/dds/host_addresses.h"
#include "services/dds/participant.h"
#include "services/dds/security.h"
#include "services/rpc/certificate_monitor.h"
#include "services/rpc/credentials.h"
#include "services/runtime/core_dumps.h"
#include "services/runtime/daemon_flags.h"
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

namespace {

using rips::actuator::Agent;
using rips::actuator::LoadedConfig;

// How soon other addresses of the host are followed.
constexpr absl::Duration kLook = absl::Seconds(1);
// Looks between attempts to find the way to the System Modes where no address changes.
constexpr int kModesRetryLooks = 5;

int Fail(int code, const absl::Status& status) {
  std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  return code;
}

int CheckConfig(const std::string& file, const LoadedConfig& loaded) {
  const std::string state = rips::ParentDirectory(loaded.config.state_dir);
  if (const absl::Status there = rips::CheckDirectories(file, {{"state_dir", state}});
      !there.ok()) {
    return Fail(rips::kExitConfig, there);
  }
  if (const auto enclave = rips::dds::LoadSecurity(loaded.config.dds, absl::Now()); !enclave.ok()) {
    return Fail(rips::kExitConfig, enclave.status());
  }
  std::string certificate;
  const absl::Status mine = rips::rpc::CheckOwn(
      loaded.config.tls,
      [&](const rips::rpc::PeerIdentity& self) {
        return rips::actuator::CheckIdentity(loaded.config, self);
      },
      &certificate);
  if (!mine.ok()) return Fail(rips::kExitConfig, mine);
  rips::OutputStream out(STDOUT_FILENO);
  out << rips::FormatSettings(loaded.settings);
  std::vector<std::string> warnings = rips::actuator::Warnings(loaded);
  // What may come before the daemon starts.
  warnings.push_back(certificate);
  warnings.emplace_back(rips::dds::FindInterface(loaded.config.dds.interface).message());
  rips::PrintWarnings(warnings);
  return out.End(0);
}

// The agent, started again when it can do what it could not at its start, or when DDS must begin
// again on other addresses. The robot stays at its level meanwhile.
class Running {
 public:
  Running(const LoadedConfig* loaded, rips::Metrics* metrics, rips::ServiceManager* manager)
      : loaded_(loaded),
        metrics_(metrics),
        manager_(manager),
        credentials_(loaded->config.tls),
        addresses_(rips::dds::OperatorsOwnConfiguration() ? "" : loaded->config.dds.interface) {
    monitor_.emplace(rips::rpc::CertificateMonitor::Options{.own = loaded->config.tls}, &clock_,
                     metrics);
  }

  absl::Status Start() {
    auto agent = Agent::Start(*loaded_, credentials_, &clock_, metrics_, &*monitor_,
                              [manager = manager_] { manager->Ping(); });
    if (!agent.ok()) return agent.status();
    rips::MutexLock lock(&mu_);
    agent_ = *std::move(agent);
    return absl::OkStatus();
  }
  absl::Status Ready() {
    rips::MutexLock lock(&mu_);
    return agent_ == nullptr ? absl::UnavailableError("starting anew") : agent_->Ready();
  }
  std::string Describe() {
    rips::MutexLock lock(&mu_);
    return agent_ == nullptr ? "starting anew" : agent_->Describe();
  }
  // Until SIGTERM. Not OK: it cannot be started again.
  absl::Status Wait(rips::SignalWaiter& signals) {
    while (!signals.WaitForShutdown(kLook)) {
      if (!Look()) continue;
      std::unique_ptr<Agent> old;
      {
        rips::MutexLock lock(&mu_);
        old = std::move(agent_);
      }
      old.reset();
      if (absl::Status again = Start(); !again.ok()) return again;
    }
    return absl::OkStatus();
  }

 private:
  // True if the agent is to start again.
  bool Look() {
    const auto host = rips::dds::HostAddresses();
    const int64_t now_ns = clock_.Now().boottime_ns;
    if (!agent_->modes_problem().ok()) {
      const bool moved = host.ok() && addresses_.MayBegin(*host, now_ns);
      if (!moved && ++looks_ < kModesRetryLooks) return false;
      looks_ = 0;
      if (!Agent::TryModes(*loaded_, &clock_).ok()) return false;
      rips::LogInfo("System Modes reachable; restarting");
      return true;
    }
    if (!host.ok()) return false;
    const bool again = addresses_.Look(agent_->interfaces(), *host, now_ns);
    if (again) {
      rips::LogWarning("DDS begins again on other addresses; restarting",
                       {{"change", addresses_.change()}});
    } else {
      addresses_.SeenAgain();
    }
    return again;
  }

  const LoadedConfig* loaded_;
  rips::Metrics* metrics_;
  rips::ServiceManager* manager_;
  const rips::RealClock clock_;
  rips::rpc::CredentialsSource credentials_;
  std::optional<rips::rpc::CertificateMonitor> monitor_;
  rips::dds::AddressWatch addresses_;
  int looks_ = 0;
  rips::Mutex mu_;  // agent_ is changed by the main thread alone
  std::unique_ptr<Agent> agent_;
};

}  // namespace

int main(int argc, char** argv) {
  rips::OpenStandardStreams();
  rips::ForbidCoreDumps();
  rips::rpc::RequireTls13();
  rips::rpc::RouteGrpcLogs();
  rips::rpc::TrustGrpcLockOrder();
  auto notify = rips::ServiceManager::FromEnvironment();
  rips::DaemonFlags flags;
  const rips::DaemonInfo info = {.name = "rips-actuator",
                                 .description = "Applies alert levels to a ROS 2 robot.",
                                 .default_config = "/etc/rips/actuator.yaml"};
  if (std::optional<int> code = rips::ParseDaemonFlags(argc, argv, info, &flags)) return *code;
  if (!flags.check_config) rips::StartLogWriter();
  rips::ServiceManager manager(std::move(notify));
  rips::BlockSignals();

  const auto loaded = rips::actuator::LoadConfig(flags.config);
  if (!loaded.ok()) return Fail(rips::kExitConfig, loaded.status());
  if (flags.check_config) return CheckConfig(flags.config, *loaded);

  rips::Metrics metrics;
  rips::SignalWaiter signals({});
  Running running(&*loaded, &metrics, &manager);
  // Before anything else that may fail: the robot is at the level its state demands, or on its way.
  const absl::Status started = running.Start();
  if (absl::IsPermissionDenied(started)) return Fail(rips::kExitConfig, started);
  if (!started.ok()) return Fail(rips::kExitFailed, started);
  const auto page =
      rips::MetricsPage::Start(loaded->config.metrics, &metrics, [&] { return running.Ready(); });
  if (!page.ok()) return Fail(rips::kExitConfig, page.status());
  rips::LogInfo("listening", {{"address", (*page)->address()}});
  if (const absl::Status ready = rips::WriteReadyFile(flags, "ready"); !ready.ok()) {
    return Fail(rips::kExitFailed, ready);
  }
  manager.Ready();
  absl::Status ended;
  {
    const rips::Ticker status(absl::ZeroDuration(), [&] {
      manager.SetStatus(running.Describe());
      return rips::ServiceManager::kStatusEvery;
    });
    ended = running.Wait(signals);
  }
  manager.Stopping();
  if (!ended.ok()) return Fail(rips::kExitFailed, ended);
  rips::LogInfo("stopping");
  return 0;
}
