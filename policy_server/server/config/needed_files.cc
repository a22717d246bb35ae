#include "policy_server/server/config/needed_files.h"

#include <filesystem>
#include <system_error>
#include <vector>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/needed_directories.h"

namespace rips::server {

absl::Status CheckNeededDirectories(absl::string_view file, const ServerConfig& config) {
  std::vector<NeededDirectory> needed = {
      {"bundles.source", config.bundles_source},
      {"store.path", ParentDirectory(config.store_path)},
      {"alerts.file", ParentDirectory(config.alerts.path)},
  };
  if (!config.audit_dir.empty()) {
    needed.push_back({"audit.dir", ParentDirectory(config.audit_dir)});
  }
  if (config.recordings_bytes > 0) {
    needed.push_back({"recordings.dir", ParentDirectory(config.recordings_directory())});
  }
  RIPS_RETURN_IF_ERROR(CheckDirectories(file, needed));
  std::error_code error;
  if (config.alerts.rotate_bytes > 0 && std::filesystem::is_symlink(config.alerts.path, error)) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": `alerts.file` is the symbolic link `", config.alerts.path,
                     "`, which `rotate_bytes` does not move; name the file, or leave "
                     "`rotate_bytes` out"));
  }
  return absl::OkStatus();
}

absl::Status CheckIdentity(const ServerConfig& config, const rpc::PeerIdentity& self) {
  if (self.role == rpc::Role::kPolicyServer && self.name == config.id &&
      self.trust_domain == config.trust_domain) {
    return absl::OkStatus();
  }
  return absl::PermissionDeniedError(
      absl::StrCat(config.tls.cert, " is the certificate of ", rpc::ToString(self),
                   ", not of spiffe://", config.trust_domain, "/policy-server/", config.id));
}

}  // namespace rips::server
