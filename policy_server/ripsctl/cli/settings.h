// Where ripsctl connects and as whom. Each setting comes from the first of: flag, environment
// variable, chosen context of the settings file, top of the settings file, default.
//
//   current: lab                    # unless --context or RIPSCTL_CONTEXT names another
//   ca: ca.pem                      # of each context that has no `ca`; relative to this file
//   contexts:
//     lab: {server: "lab.example:7443", cert: lab/alice.pem, key: lab/alice.key}
//     site: {server: "site.example:7443", cert: site/alice.pem, key: site/alice.key}
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_SETTINGS_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_SETTINGS_H_

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

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
  // Of the settings file. Not a key of the file, where `current` chooses.
  std::string context;
};

// A context gives the keys of RawSettings.
struct SettingsFile {
  RawSettings top;
  std::map<std::string, RawSettings> contexts;
  std::string current;  // may name no context; empty = none
};

// The value of an environment variable, or nullopt.
using GetEnv = std::function<std::optional<std::string>(const std::string&)>;

// `$HOME/.config/rips/ripsctl.yaml`; empty without HOME.
std::string SettingsPath(const GetEnv& get_env);

// The text of a settings file. All keys are optional, but a context needs `server`. Relative paths
// in it are taken from the directory of `file`. InvalidArgument with every problem and its place.
absl::StatusOr<SettingsFile> ParseSettings(absl::string_view file, absl::string_view text);

// The name that `flags`, the environment or `file` gives, in this order; empty if none does.
// InvalidArgument for a name that `file` does not have, with those that it has.
absl::StatusOr<std::string> ChooseContext(const RawSettings& flags, const GetEnv& get_env,
                                          const SettingsFile& file);
// The same for a given name.
absl::Status CheckContext(absl::string_view name, absl::string_view origin,
                          const SettingsFile& file);

// Fills what `flags` leaves empty from the environment, then from the context that it names, then
// from the top of `file`, then by defaults (127.0.0.1:7443, text, 10s).
RawSettings Merge(RawSettings flags, const GetEnv& get_env, const SettingsFile& file);

// The text of a settings file with `current: name`; all else stays byte for byte. `file` is its
// path. FailedPrecondition if `current` is not on a line of its own, in the first column.
absl::StatusOr<std::string> WithCurrentContext(absl::string_view file, absl::string_view text,
                                               absl::string_view name);

inline constexpr absl::string_view kSettingVariablePrefix = "RIPSCTL_";
// The environment variables that are settings, RIPSCTL_CONTEXT included.
std::vector<std::string> SettingVariables();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_SETTINGS_H_
