#include "policy_server/policy/bundle/inspection_source.h"

#include <algorithm>
#include <filesystem>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "services/base/status_macros.h"

namespace rips::bundle {

absl::StatusOr<std::string> InspectionSource::Read(absl::string_view path, size_t bytes_max) const {
  absl::string_view inside = path;
  if (!absl::ConsumePrefix(&inside, prefix_)) {
    return absl::FailedPreconditionError(absl::StrCat("`", path, "` is not inside the bundle"));
  }
  if (std::find(manifest_.yara.begin(), manifest_.yara.end(), inside) == manifest_.yara.end()) {
    return absl::FailedPreconditionError(
        absl::StrCat("`", inside, "` is not listed under `yara` in the manifest; add it there"));
  }
  return directory_.Read(inside, bytes_max);
}

absl::StatusOr<std::string> InspectionSource::ProgramPath(const lang::Inspection& plugin) const {
  const auto listed =
      std::find_if(manifest_.plugins.begin(), manifest_.plugins.end(),
                   [&](const ManifestPlugin& entry) { return entry.id == plugin.name; });
  if (listed == manifest_.plugins.end()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "plugin `", plugin.name, "` is not listed under `plugins` in the manifest; add it there"));
  }
  RIPS_ASSIGN_OR_RETURN(const std::string program, directory_.Read(listed->path, kPluginBytesMax));
  const std::string found = Sha256Hex(program);
  if (found != listed->sha256) {
    return absl::FailedPreconditionError(absl::StrCat("plugin `", plugin.name, "`: `", listed->path,
                                                      "` has SHA-256 ", found,
                                                      ", the manifest says ", listed->sha256));
  }
  std::error_code error;
  const std::filesystem::path dir = std::filesystem::absolute(dir_, error);
  if (error) return absl::UnavailableError(absl::StrCat("`", dir_, "`: ", error.message()));
  return (dir / listed->path).string();
}

std::string InspectionSource::ReadableRoot(absl::string_view /*path*/) const {
  std::error_code error;
  const std::filesystem::path dir = std::filesystem::absolute(dir_, error);
  return error ? "" : dir.string();
}

}  // namespace rips::bundle
