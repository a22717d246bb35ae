#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "mode_actuator/link/agent.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"

namespace rips::actuator {

absl::StatusOr<LoadedConfig> LoadConfig(const std::string& path) {
  LoadedConfig loaded;
  RIPS_ASSIGN_OR_RETURN(const std::string text, ReadConfigFile(path));
  RIPS_ASSIGN_OR_RETURN(ParsedConfig parsed, ParseConfig(path, text));
  RIPS_RETURN_IF_ERROR(AddScripts(&parsed));
  loaded.config = std::move(parsed.config);
  loaded.settings = std::move(parsed.settings);
  RIPS_RETURN_IF_ERROR(CheckFirewallFiles(loaded.config.levels, loaded.settings));
  if (loaded.config.smh_file.empty()) return loaded;
  RIPS_ASSIGN_OR_RETURN(const std::string smh_text, ReadFile(loaded.config.smh_file, kSmhBytesMax));
  RIPS_ASSIGN_OR_RETURN(loaded.smh, ParseSmh(smh_text, loaded.config.smh_file));
  RIPS_RETURN_IF_ERROR(CheckLevelsAgainstSmh(loaded.config, loaded.smh));
  return loaded;
}

absl::Status CheckIdentity(const Config& config, const rpc::PeerIdentity& self) {
  if (self.role == rpc::Role::kActuator && self.robot == config.robot && self.host == config.host) {
    return absl::OkStatus();
  }
  return absl::PermissionDeniedError(absl::StrCat(
      "the certificate is of `", ToString(self), "`, but the configuration says robot `",
      config.robot, "`, host `", config.host, "` of an actuator; correct the one that is wrong"));
}

std::vector<std::string> Warnings(const LoadedConfig& loaded) {
  std::vector<std::string> warnings = loaded.smh.warnings;
  for (std::string& warning : MonotonyWarnings(loaded.config, loaded.smh)) {
    warnings.push_back(std::move(warning));
  }
  for (std::string& warning : FirewallWarnings(loaded.config.levels)) {
    warnings.push_back(std::move(warning));
  }
  return warnings;
}

}  // namespace rips::actuator
