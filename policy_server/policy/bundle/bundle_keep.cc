#include "policy_server/policy/bundle/bundle_keep.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/policy/bundle/inspection_source.h"
#include "services/base/status_macros.h"
#include "services/runtime/unique_fd.h"

namespace rips::bundle {
namespace {

namespace fs = std::filesystem;

constexpr absl::string_view kIdPrefix = "sha256:";
constexpr size_t kDigits = 64;
constexpr absl::string_view kHalfMade = ".new-";

bool IsDigits(absl::string_view name) {
  return name.size() == kDigits &&
         name.find_first_not_of("0123456789abcdef") == absl::string_view::npos;
}

absl::Status FromError(int error, absl::string_view doing, const std::string& path) {
  const std::string text = absl::StrCat(doing, " `", path, "`: ", std::strerror(error));
  if (error == ENOSPC || error == EDQUOT) return absl::ResourceExhaustedError(text);
  return absl::UnavailableError(text);
}

absl::Status SyncPath(const std::string& path) {
  const UniqueFd fd(open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (fd.get() < 0 || fsync(fd.get()) != 0) return FromError(errno, "syncing", path);
  return absl::OkStatus();
}

absl::Status WriteFile(const std::string& path, absl::string_view bytes, mode_t mode) {
  std::error_code error;
  fs::create_directories(fs::path(path).parent_path(), error);
  if (error) return FromError(error.value(), "making the directory of", path);
  const UniqueFd fd(open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, mode));
  if (fd.get() < 0) return FromError(errno, "creating", path);
  while (!bytes.empty()) {
    const ssize_t wrote = write(fd.get(), bytes.data(), bytes.size());
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote < 0) return FromError(errno, "writing", path);
    bytes.remove_prefix(static_cast<size_t>(wrote));
  }
  if (fsync(fd.get()) != 0) return FromError(errno, "syncing", path);
  return absl::OkStatus();
}

// All that the manifest lists, into `to`, which is not there yet.
absl::Status CopyBundle(const std::string& dir, const std::string& to) {
  RIPS_ASSIGN_OR_RETURN(const BundleDirectory from, BundleDirectory::Open(dir));
  RIPS_ASSIGN_OR_RETURN(const std::string text, from.Read(kManifestName, kManifestBytesMax));
  RIPS_ASSIGN_OR_RETURN(const Manifest manifest,
                        ParseManifest(absl::StrCat(dir, "/", kManifestName), text));
  RIPS_RETURN_IF_ERROR(WriteFile(absl::StrCat(to, "/", kManifestName), text, 0640));
  std::set<std::string> done;
  const auto copy = [&](const std::string& path, size_t bytes_max, mode_t mode) -> absl::Status {
    if (!done.insert(path).second) return absl::OkStatus();
    RIPS_ASSIGN_OR_RETURN(const std::string bytes, from.Read(path, bytes_max));
    return WriteFile(absl::StrCat(to, "/", path), bytes, mode);
  };
  // Plugins may run as another user.
  for (const ManifestPlugin& plugin : manifest.plugins) {
    RIPS_RETURN_IF_ERROR(copy(plugin.path, kPluginBytesMax, 0755));
  }
  for (const std::string& path : manifest.rules) {
    RIPS_RETURN_IF_ERROR(copy(path, kBundleBytesMax, 0640));
  }
  for (const std::string& path : manifest.yara) {
    RIPS_RETURN_IF_ERROR(copy(path, kBundleBytesMax, 0640));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::string> KeptBundlePath(const std::string& keep_dir, absl::string_view id) {
  absl::string_view digits = id;
  if (!absl::ConsumePrefix(&digits, kIdPrefix) || !IsDigits(digits)) {
    return absl::InvalidArgumentError("this is not the id of a bundle");
  }
  return absl::StrCat(keep_dir, "/", digits);
}

absl::Status KeepBundle(const std::string& dir, absl::string_view id, const std::string& keep_dir) {
  RIPS_ASSIGN_OR_RETURN(const std::string path, KeptBundlePath(keep_dir, id));
  std::error_code error;
  if (fs::exists(path, error) && CheckBundle(path).id == id) return absl::OkStatus();
  fs::create_directories(keep_dir, error);
  if (error) return FromError(error.value(), "making", keep_dir);
  const std::string fresh =
      absl::StrCat(keep_dir, "/", kHalfMade, fs::path(path).filename().string());
  fs::remove_all(fresh, error);
  absl::Status status = CopyBundle(dir, fresh);
  if (status.ok() && CheckBundle(fresh).id != id) {
    status = absl::AbortedError(absl::StrCat("`", dir, "` was changed while it was copied"));
  }
  if (status.ok()) {
    fs::remove_all(path, error);  // a damaged one
    fs::rename(fresh, path, error);
    if (error) status = FromError(error.value(), "renaming", fresh);
  }
  if (!status.ok()) {
    fs::remove_all(fresh, error);
    return status;
  }
  return SyncPath(keep_dir);
}

void ForgetBundles(const std::string& keep_dir, const std::set<std::string>& in_use) {
  std::error_code error;
  std::vector<std::pair<fs::file_time_type, fs::path>> unused;
  for (fs::directory_iterator it(keep_dir, error), end; !error && it != end; it.increment(error)) {
    const std::string name = it->path().filename().string();
    std::error_code ignored;
    if (absl::string_view(name).substr(0, kHalfMade.size()) == kHalfMade) {
      fs::remove_all(it->path(), ignored);
    } else if (IsDigits(name) && !in_use.contains(absl::StrCat(kIdPrefix, name))) {
      unused.emplace_back(fs::last_write_time(it->path(), ignored), it->path());
    }
  }
  if (unused.size() <= kUnusedKeptMax) return;
  std::sort(unused.begin(), unused.end());
  unused.resize(unused.size() - kUnusedKeptMax);
  for (const auto& [time, path] : unused) fs::remove_all(path, error);
}

}  // namespace rips::bundle
