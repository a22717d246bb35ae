// rips-wire: tells the sensor what is on the wire of a DDS domain, whether discovery shows it or
// not.
#include <sys/eventfd.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <iostream>
#include <memory>
#include <optional>
#include <string>

#include "CLI/CLI.hpp"
#include "absl/strings/str_cat.h"
#include "sensor_agent/wire/tap.h"
#include "services/runtime/core_dumps.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/log.h"
#include "services/runtime/output_stream.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/service_manager.h"
#include "services/runtime/shutdown.h"
#include "services/runtime/unique_fd.h"

namespace rips::wire {
namespace {

struct Flags {
  TapOptions tap;
  DaemonFlags daemon;
};

// As ParseDaemonFlags.
std::optional<int> ParseFlags(int argc, char** argv, Flags& flags) {
  CLI::App app("Tells the sensor what is on the wire of a DDS domain.", "rips-wire");
  std::string log_level = "info";
  app.add_option("--domain", flags.tap.domain, "DDS domain id, that of the sensor")
      ->capture_default_str();
  app.add_option("--interface", flags.tap.interfaces,
                 "Network interface to listen on; may be repeated [all]");
  app.add_option("--socket", flags.tap.socket, "Where the sensor listens")->capture_default_str();
  app.add_option("--log-level", log_level, "debug, info, warning or error")
      ->capture_default_str()
      ->check([](const std::string& name) {
        const absl::StatusOr<LogLevel> level = ParseLogLevel(name);
        return level.ok() ? std::string() : std::string(level.status().message());
      });
  app.add_option("--ready-file", flags.daemon.ready_file, "File written once listening");
  app.set_version_flag("--version", absl::StrCat("rips-wire ", RipsVersion()));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    OutputStream out(STDOUT_FILENO);
    return out.End(app.exit(error, out, std::cerr) == 0 ? 0 : kExitConfig);
  }
  SetLogLevel(*ParseLogLevel(log_level));
  return std::nullopt;
}

int Fail(absl::string_view doing, const absl::Status& status) {
  LogError(doing, {{"error", status.message()}});
  return status.code() == absl::StatusCode::kInvalidArgument ? kExitConfig : kExitFailed;
}

int Run(int argc, char** argv) {
  Flags flags;
  if (const std::optional<int> exit_code = ParseFlags(argc, argv, flags); exit_code.has_value()) {
    return *exit_code;
  }
  QueueLog();  // its thread starts without the privileges that Tap::Create gives up
  ServiceManager manager(ServiceManager::FromEnvironment());
  BlockSignals();
  const RealClock clock;
  // Before any thread starts, since it gives up the privileges of this one.
  const auto tap = Tap::Create(flags.tap, &clock);
  if (!tap.ok()) return Fail("cannot listen", tap.status());
  StartLogThread();
  const UniqueFd stop(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (stop.get() < 0) return Fail("cannot start", absl::ErrnoToStatus(errno, "eventfd"));
  const auto on_signal = [&stop] { eventfd_write(stop.get(), 1); };
  const SignalWaiter signals({{SIGTERM, on_signal}, {SIGINT, on_signal}});
  if (absl::Status written = WriteReadyFile(flags.daemon, "ready"); !written.ok()) {
    return Fail("cannot write the ready file", written);
  }
  manager.Ready();
  const absl::Status ended = (*tap)->Run(stop.get(), [&manager] { manager.Ping(); });
  manager.Stopping();
  if (!ended.ok()) return Fail("stopped listening", ended);
  LogInfo("stopping");
  return 0;
}

}  // namespace
}  // namespace rips::wire

int main(int argc, char** argv) {
  rips::OpenStandardStreams();
  rips::ForbidCoreDumps();
  return rips::wire::Run(argc, argv);
}
