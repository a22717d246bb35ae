// Where ripsctl connects and as whom. Each setting comes from the first of: flag, environment
// variable, settings file, default.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_SETTINGS_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_SETTINGS_H_

#include <functional>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::ripsctl {

// As text, not yet checked; empty = not given. Flags `--server`; environment `RIPSCTL_SERVER`; keys
// of the file `server`.
struct RawSettings {
  std::string server;  // HOST:PORT
  std::string cert;    // PEM files
  std::string key;
  std::string ca;
  std::string output;   // text | json
  std::string timeout;  // `10s`
};

// The value of an environment variable, or nullopt.
using GetEnv = std::function<std::optional<std::string>(const std::string&)>;

// `$HOME/.config/rips/ripsctl.yaml`; empty without HOME.
std::string SettingsPath(const GetEnv& get_env);

// The text of a settings file: the keys above, all optional. InvalidArgument with every problem and
// its place.
absl::StatusOr<RawSettings> ParseSettings(absl::string_view file, absl::string_view text);

// Fills what `flags` leaves empty from the environment, then from `file`, then by defaults
// (127.0.0.1:7443, text, 10s).
RawSettings Merge(RawSettings flags, const GetEnv& get_env, const RawSettings& file);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_SETTINGS_H_
