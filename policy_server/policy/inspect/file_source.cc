#include "policy_server/policy/inspect/file_source.h"

#include <filesystem>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "services/runtime/atomic_file.h"

namespace rips::inspect {

absl::StatusOr<std::string> DiskFiles::Read(absl::string_view path, size_t bytes_max) const {
  return ReadFile(std::string(path), bytes_max);
}

absl::StatusOr<std::string> DiskFiles::ProgramPath(const lang::Inspection& plugin) const {
  std::error_code error;
  const std::filesystem::path path = std::filesystem::absolute(plugin.path, error);
  if (error) {
    return absl::UnavailableError(absl::StrCat("`", plugin.path, "`: ", error.message()));
  }
  return path.string();
}

std::string DiskFiles::ReadableRoot(absl::string_view path) const {
  const std::filesystem::path directory = std::filesystem::path(std::string(path)).parent_path();
  return (directory.filename() == "plugins" ? directory.parent_path() : directory).string();
}

}  // namespace rips::inspect
