// rips-policy-server: holds the rule engine and the alert level of a fleet.
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/bundle/inventory_files.h"
#include "policy_server/server/config/config.h"
#include "policy_server/server/config/needed_files.h"
#include "policy_server/server/enrol/enrolment.h"
#include "policy_server/server/server.h"
#include "services/rpc/credentials.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/core_dumps.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/log.h"
#include "services/runtime/needed_directories.h"
#include "services/runtime/output_stream.h"
#include "services/runtime/service_manager.h"
#include "services/runtime/shutdown.h"
#include "services/runtime/ticker.h"

namespace {

// --check-config: of the files that the configuration names, too.
int CheckConfig(const std::string& file, const rips::server::ParsedServerConfig& parsed) {
  absl::Status problem = rips::server::CheckNeededDirectories(file, parsed.config);
  rips::bundle::InventoryFiles inventory;
  if (problem.ok()) {
    auto read = rips::bundle::ReadInventory(parsed.config.inventory);
    problem = read.status();
    if (read.ok()) inventory = *std::move(read);
  }
  const rips::server::EnrolmentConfig& enrolment = parsed.config.enrolment;
  if (problem.ok() && enrolment.enabled()) {
    problem = enrolment.external_ca.program.empty()
                  ? rips::enrol::CheckIssuingFiles(
                        {.cert = enrolment.cert, .key = enrolment.key, .ca = parsed.config.tls.ca})
                  : rips::enrol::CheckExternalCaProgram(enrolment.external_ca.program[0]);
  }
  std::string certificate;
  if (problem.ok()) {
    problem = rips::rpc::CheckOwn(
        parsed.config.tls,
        [&](const rips::rpc::PeerIdentity& self) {
          return rips::server::CheckIdentity(parsed.config, self);
        },
        &certificate);
  }
  if (!problem.ok()) {
    std::fprintf(stderr, "%s\n", std::string(problem.message()).c_str());
    return rips::kExitConfig;
  }
  rips::OutputStream out(STDOUT_FILENO);
  out << rips::FormatSettings(parsed.settings);
  for (const auto& [path, robots] : inventory.files) {
    out << "robots of " << path << ": " << robots << "\n";
  }
  std::map<std::string, size_t> bundles;
  for (const auto& robot : inventory.inventory.robots) ++bundles[robot.bundle];
  for (const auto& [bundle, robots] : bundles) {
    out << "robots with bundle " << bundle << ": " << robots << "\n";
  }
  std::vector<std::string> warnings = {certificate};
  for (const auto& [bundle, robots] : bundles) {
    const std::string manifest =
        absl::StrCat(parsed.config.bundles_source, "/", bundle, "/manifest.yaml");
    std::error_code error;
    if (std::filesystem::exists(manifest, error)) continue;
    warnings.push_back(absl::StrCat("no ", manifest, ": unless one is pushed, nothing judges ",
                                    robots, " robots"));
  }
  warnings.insert(warnings.end(), inventory.inventory.warnings.begin(),
                  inventory.inventory.warnings.end());
  rips::PrintWarnings(warnings);  // what may come before the daemon starts
  return out.End(0);
}

}  // namespace

int main(int argc, char** argv) {
  using namespace rips;
  OpenStandardStreams();
  ForbidCoreDumps();
  rpc::RequireTls13();
  rpc::RouteGrpcLogs();
  rpc::TrustGrpcLockOrder();
  auto notify = ServiceManager::FromEnvironment();
  DaemonFlags flags;
  const DaemonInfo info{.name = "rips-policy-server",
                        .description = "Judges what sensors see and commands mode actuators.",
                        .default_config = "/etc/rips/policy-server.yaml"};
  if (const auto code = ParseDaemonFlags(argc, argv, info, &flags)) return *code;
  if (!flags.check_config) StartLogWriter();
  ServiceManager manager(std::move(notify));

  const absl::StatusOr<std::string> text = ReadConfigFile(flags.config);
  if (!text.ok()) {
    std::fprintf(stderr, "%s\n", std::string(text.status().message()).c_str());
    return kExitConfig;
  }
  const auto parsed = server::ParseServerConfig(flags.config, *text);
  if (!parsed.ok()) {
    std::fprintf(stderr, "%s\n", std::string(parsed.status().message()).c_str());
    return kExitConfig;
  }
  if (flags.check_config) return CheckConfig(flags.config, *parsed);

  BlockSignals();
  // Signals are taken from here on: the start may wait for a certificate, and must end if told to.
  std::unique_ptr<server::Server> owned;  // outlives `signals`, which calls it
  std::atomic<server::Server*> running = nullptr;
  SignalWaiter signals({{SIGHUP, [&] {
                           if (server::Server* each = running) {
                             manager.Reloading();
                             each->Reload();
                             manager.Ready();
                           }
                           const absl::StatusOr<std::string> now = ReadConfigFile(flags.config);
                           if (now.ok() && *now == *text) return;
                           LogWarning(
                               "the configuration has changed and is read at start only; restart "
                               "the server to apply it",
                               {{"file", flags.config}});
                         }}});
  auto started = server::Server::Start(
      parsed->config,
      [&](absl::Duration pause) {
        manager.SetStatus("not serving: waiting for a usable certificate; the log says why");
        return signals.WaitForShutdown(pause);
      },
      [&] { manager.Ping(); }, parsed->settings);
  if (absl::IsCancelled(started.status())) return 0;
  if (!started.ok()) {
    LogError("cannot start", {{"reason", started.status().message()}});
    return absl::IsInvalidArgument(started.status()) ? kExitConfig : kExitFailed;
  }
  owned = *std::move(started);
  running = owned.get();
  if (const absl::Status ready = WriteReadyFile(flags, owned->address()); !ready.ok()) {
    LogError("cannot write the ready file", {{"reason", ready.message()}});
    return kExitFailed;
  }
  manager.Ready();
  {
    const Ticker status(absl::ZeroDuration(), [&] {
      manager.SetStatus(owned->Describe());
      return ServiceManager::kStatusEvery;
    });
    signals.WaitForShutdown();
  }
  manager.Stopping();
  owned->Stop();
  return 0;
}
