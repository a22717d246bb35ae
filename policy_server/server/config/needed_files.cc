#include "policy_server/server/config/needed_files.h"

#include <vector>

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
  return CheckDirectories(file, needed);
}

}  // namespace rips::server
