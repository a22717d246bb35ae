// rips-fw: changes the packet filter of one robot host for rips-actuator. The only process of RIPS
// that needs CAP_NET_ADMIN; it serves only root and one user, on a Unix socket.
#include <unistd.h>

#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "mode_actuator/config/config.h"
#include "mode_actuator/helpers/fw/firewall.h"
#include "mode_actuator/helpers/fw/fw_server.h"
#include "mode_actuator/helpers/fw/nft_runner.h"
#include "mode_actuator/steps/firewall/real_host.h"
#include "services/base/status_macros.h"
#include "services/local_socket/helper_socket.h"
#include "services/runtime/core_dumps.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/log.h"
#include "services/runtime/output_stream.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/service_manager.h"
#include "services/runtime/shutdown.h"

namespace {

using rips::actuator::Firewall;
using rips::actuator::FwServer;
using rips::actuator::ParsedConfig;

int Fail(int code, const absl::Status& status) {
  std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  return code;
}

absl::StatusOr<ParsedConfig> Load(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, rips::ReadConfigFile(path));
  RIPS_ASSIGN_OR_RETURN(ParsedConfig parsed, rips::actuator::ParseConfig(path, text));
  RIPS_RETURN_IF_ERROR(rips::actuator::CheckFirewallFiles(parsed.config.levels, parsed.settings));
  return parsed;
}

}  // namespace

int main(int argc, char** argv) {
  rips::OpenStandardStreams();
  rips::ForbidCoreDumps();
  auto notify = rips::ServiceManager::FromEnvironment();
  rips::DaemonFlags flags;
  const rips::DaemonInfo info = {.name = "rips-fw",
                                 .description = "Changes the packet filter for rips-actuator.",
                                 .default_config = "/etc/rips/actuator.yaml"};
  if (std::optional<int> code = rips::ParseDaemonFlags(argc, argv, info, &flags)) return *code;
  if (!flags.check_config) rips::StartLogWriter();
  rips::ServiceManager manager(std::move(notify));
  rips::BlockSignals();
  const auto loaded = Load(flags.config);
  if (!loaded.ok()) return Fail(rips::kExitConfig, loaded.status());
  if (flags.check_config) {
    rips::OutputStream out(STDOUT_FILENO);
    out << rips::FormatSettings(loaded->settings);
    return out.End(0);
  }
  const rips::actuator::Config& config = loaded->config;
  const auto user = rips::actuator::FindUser(config.firewall.user, "firewall.user");
  if (!user.ok()) return Fail(rips::kExitConfig, user.status());

  const rips::RealClock clock;
  rips::actuator::NftRunner nft({});
  rips::actuator::RealHost host(config.servers);
  Firewall firewall(
      {.files = rips::actuator::FirewallFiles(config.levels), .hold = config.firewall.hold}, &nft,
      &host, &clock);
  if (const absl::Status files = firewall.CheckFiles(); !files.ok()) {
    const bool theirs = absl::IsInvalidArgument(files) || absl::IsPermissionDenied(files);
    return Fail(theirs ? rips::kExitConfig : rips::kExitFailed, files);
  }
  rips::SignalWaiter signals({});
  auto listener = rips::actuator::ListenForHelper(config.firewall.socket, *user);
  if (!listener.ok()) return Fail(rips::kExitFailed, listener.status());
  FwServer server(*std::move(listener), *user, [&](const rips::actuator::FwRequest& request) {
    return firewall.Handle(request);
  });
  std::thread serving([&] { server.Run(); });
  rips::LogInfo("listening", {{"address", config.firewall.socket}});
  absl::Status ready = rips::WriteReadyFile(flags, "ready");
  if (ready.ok()) {
    manager.Ready();
    signals.WaitForShutdown();
  }
  manager.Stopping();
  // What is in force stays so: the kernel holds it, and its time limits.
  rips::LogInfo("stopping");
  server.Stop();
  serving.join();
  return ready.ok() ? 0 : Fail(rips::kExitFailed, ready);
}
