#include "services/runtime/needed_directories.h"

#include <cstdio>
#include <filesystem>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace rips {

std::string ParentDirectory(absl::string_view path) {
  while (path.size() > 1 && path.back() == '/') path.remove_suffix(1);
  path = path.substr(0, path.rfind('/') + 1);
  while (path.size() > 1 && path.back() == '/') path.remove_suffix(1);
  return std::string(path);
}

absl::Status CheckDirectories(absl::string_view file, const std::vector<NeededDirectory>& needed) {
  std::vector<std::string> problems;
  for (const auto& [key, path] : needed) {
    std::error_code error;
    const std::filesystem::file_status status = std::filesystem::status(path, error);
    if (error == std::errc::permission_denied || std::filesystem::is_directory(status)) continue;
    const bool exists = std::filesystem::exists(status);
    problems.push_back(absl::StrCat(file, ": `", key, "` needs the directory `", path, "`, which ",
                                    exists ? "is no directory" : "does not exist; create it"));
  }
  if (problems.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrJoin(problems, "\n"));
}

void PrintWarnings(const std::vector<std::string>& warnings) {
  for (const std::string& each : warnings) {
    if (!each.empty()) std::fprintf(stderr, "warning: %s\n", each.c_str());
  }
}

}  // namespace rips
