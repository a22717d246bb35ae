// The command line every daemon has.
#ifndef RIPS_SERVICES_RUNTIME_DAEMON_FLAGS_H_
#define RIPS_SERVICES_RUNTIME_DAEMON_FLAGS_H_

#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace rips {

// Exit codes of a daemon.
inline constexpr int kExitFailed = 1;  // could not start, or stopped by an error
inline constexpr int kExitConfig = 2;  // wrong flags, configuration or certificate

struct DaemonFlags {
  std::string config;         // --config FILE
  bool check_config = false;  // --check-config: print the effective configuration and end
  std::string ready_file;     // --ready-file FILE: written by WriteReadyFile; empty = none
};

struct DaemonInfo {
  std::string name;            // `rips-sensor`
  std::string description;     // one sentence for --help
  std::string default_config;  // `/etc/rips/sensor.yaml`
};

// The version of this build, `0.1.0`.
absl::string_view RipsVersion();

// Reads the flags (also --log-level, which is applied, --help and --version). A value is the code
// the process should exit with now: 0 after --help or --version, kExitConfig after a wrong flag;
// both were printed (otherwise: OutputStream::End).
std::optional<int> ParseDaemonFlags(int argc, const char* const* argv, const DaemonInfo& info,
                                    DaemonFlags* flags);

// Reports that the daemon is up and does what it can do alone: writes `contents` (the listening
// address, or `ready`) and a line break to flags.ready_file, if there is one. /readyz says whether
// the daemon is connected. While it waits for usable certificates, the file of
// | rips-policy-server         | is not written: it serves nothing yet                            |
// | rips-sensor, rips-actuator | is written: observations are kept, the robot is held at its level|
absl::Status WriteReadyFile(const DaemonFlags& flags, absl::string_view contents);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_DAEMON_FLAGS_H_
