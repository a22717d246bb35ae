#include "services/runtime/daemon_flags.h"

#include <unistd.h>

#include <iostream>

#include "CLI/CLI.hpp"
#include "absl/strings/str_cat.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/log.h"
#include "services/runtime/output_stream.h"

namespace rips {

absl::string_view RipsVersion() { return RIPS_VERSION; }

std::optional<int> ParseDaemonFlags(int argc, const char* const* argv, const DaemonInfo& info,
                                    DaemonFlags* flags) {
  CLI::App app(info.description, info.name);
  flags->config = info.default_config;
  std::string log_level = "info";
  app.add_option("--config", flags->config, "Configuration file")->capture_default_str();
  app.add_flag("--check-config", flags->check_config, "Print the effective configuration and exit");
  app.add_option("--log-level", log_level, "debug, info, warning or error")
      ->capture_default_str()
      ->check([](const std::string& name) {
        const absl::StatusOr<LogLevel> level = ParseLogLevel(name);
        return level.ok() ? std::string() : std::string(level.status().message());
      });
  app.add_option(
      "--ready-file", flags->ready_file,
      "File written once up, with the listening address or `ready`; /readyz says whether "
      "it is connected");
  app.set_version_flag("--version", absl::StrCat(info.name, " ", RipsVersion()));
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    OutputStream out(STDOUT_FILENO);
    return out.End(app.exit(error, out, std::cerr) == 0 ? 0 : kExitConfig);
  }
  SetLogLevel(*ParseLogLevel(log_level));
  return std::nullopt;
}

absl::Status WriteReadyFile(const DaemonFlags& flags, absl::string_view contents) {
  if (flags.ready_file.empty()) return absl::OkStatus();
  return WriteFileAtomically(flags.ready_file, absl::StrCat(contents, "\n"), 0644);
}

}  // namespace rips
