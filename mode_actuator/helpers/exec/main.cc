// rips-exec: runs programs of the allow-list for rips-actuator, so that the process that speaks
// with the network never starts one. It serves only root and one user, on a Unix socket.
#include <unistd.h>

#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_format.h"
#include "mode_actuator/config/config.h"
#include "mode_actuator/decide/actuator_state.h"
#include "mode_actuator/helpers/exec/enter.h"
#include "mode_actuator/helpers/exec/exec_server.h"
#include "mode_actuator/helpers/exec/posix_runner.h"
#include "services/base/status_macros.h"
#include "services/local_socket/helper_socket.h"
#include "services/runtime/core_dumps.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/log.h"
#include "services/runtime/output_stream.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/run_cgroups.h"
#include "services/runtime/service_manager.h"
#include "services/runtime/shutdown.h"

namespace {

using rips::RunCgroups;
using rips::actuator::Config;
using rips::actuator::ExecServer;
using rips::actuator::ParsedConfig;
using rips::actuator::PosixRunner;

constexpr char kWithoutCgroups[] =
    "without cgroups: a program that leaves its session is not killed with its run";

int Fail(int code, const absl::Status& status) {
  std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  return code;
}

absl::StatusOr<ParsedConfig> Load(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, rips::ReadConfigFile(path));
  RIPS_ASSIGN_OR_RETURN(ParsedConfig parsed, rips::actuator::ParseConfig(path, text));
  RIPS_RETURN_IF_ERROR(rips::actuator::AddScripts(&parsed));
  return parsed;
}

// Our predecessor is who listened at the same socket.
absl::StatusOr<std::unique_ptr<RunCgroups>> OpenCgroups(const Config& config, bool check_only) {
  std::string name = absl::StrFormat("rips-exec-%08x", rips::actuator::Crc32(config.exec.socket));
  if (check_only) name += "-check";
  int left_behind = 0;
  auto cgroups = RunCgroups::Open(config.exec.cgroup, name, &left_behind);
  if (left_behind > 0) {
    rips::LogWarning("killed processes left by a previous rips-exec", {{"processes", left_behind}});
  }
  return cgroups;
}

int CheckConfig(const ParsedConfig& parsed) {
  rips::OutputStream out(STDOUT_FILENO);
  out << rips::FormatSettings(parsed.settings);
  const auto cgroups = OpenCgroups(parsed.config, true);
  if (!cgroups.ok()) {
    out << "# warning: " << kWithoutCgroups << ": " << cgroups.status().message() << "\n";
  }
  return out.End(0);
}

}  // namespace

int main(int argc, char** argv) {
  if (rips::actuator::IsEnter(argc, argv)) return rips::actuator::EnterAndExec(argc, argv);
  rips::OpenStandardStreams();
  rips::ForbidCoreDumps();
  auto notify = rips::ServiceManager::FromEnvironment();
  rips::DaemonFlags flags;
  const rips::DaemonInfo info = {.name = "rips-exec",
                                 .description = "Runs programs for rips-actuator.",
                                 .default_config = "/etc/rips/actuator.yaml"};
  if (std::optional<int> code = rips::ParseDaemonFlags(argc, argv, info, &flags)) return *code;
  if (!flags.check_config) rips::StartLogWriter();
  rips::ServiceManager manager(std::move(notify));
  rips::BlockSignals();
  const auto loaded = Load(flags.config);
  if (!loaded.ok()) return Fail(rips::kExitConfig, loaded.status());
  if (flags.check_config) return CheckConfig(*loaded);
  const Config& config = loaded->config;
  const auto user = rips::actuator::FindUser(config.exec.user, "exec.user");
  if (!user.ok()) return Fail(rips::kExitConfig, user.status());

  const rips::RealClock clock;
  rips::SignalWaiter signals({});
  // Only one process can listen, so the processes in the cgroups have no owner.
  auto listener = rips::actuator::ListenForHelper(config.exec.socket, *user);
  if (!listener.ok()) return Fail(rips::kExitFailed, listener.status());
  const auto cgroups = OpenCgroups(config, false);
  if (!cgroups.ok()) {
    rips::LogWarning(kWithoutCgroups, {{"why", cgroups.status().message()}});
  }
  rips::actuator::PosixRunnerOptions options = {
      .allowed = config.programs, .robot = config.robot, .host = config.host};
  if (cgroups.ok()) options.cgroups = cgroups->get();
  auto runner = std::make_unique<PosixRunner>(std::move(options), &clock);
  ExecServer server(*std::move(listener), {.user = *user, .allowed = config.programs},
                    runner.get());
  std::thread serving([&] { server.Run(); });
  rips::LogInfo("listening", {{"address", config.exec.socket},
                              {"cgroups", cgroups.ok() ? (*cgroups)->path() : "none"}});
  absl::Status ready = rips::WriteReadyFile(flags, "ready");
  if (ready.ok()) {
    manager.Ready();
    signals.WaitForShutdown();
  }
  manager.Stopping();
  rips::LogInfo("stopping");
  server.Stop();
  serving.join();
  // Kills the programs that run. Their clients see the connection close.
  runner.reset();
  return ready.ok() ? 0 : Fail(rips::kExitFailed, ready);
}
