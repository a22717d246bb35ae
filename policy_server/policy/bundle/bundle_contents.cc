#include "policy_server/policy/bundle/bundle_contents.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/container/btree_map.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/policy/bundle/inspection_source.h"
#include "policy_server/policy/lang/limits.h"
#include "services/base/status_macros.h"
#include "services/runtime/unique_fd.h"

namespace rips::bundle {
namespace {

namespace fs = std::filesystem;

constexpr mode_t kPluginMode = 0755;

}  // namespace

std::vector<ContentFile> ListContents(const Manifest& manifest) {
  std::vector<ContentFile> files;
  absl::btree_map<std::string, size_t> places;
  const auto add = [&](const std::string& path, size_t bytes_max, mode_t mode) {
    const auto [place, is_new] = places.emplace(path, files.size());
    if (is_new) {
      files.push_back({path, bytes_max, mode});
      return;
    }
    ContentFile& file = files[place->second];
    file.bytes_max = std::min(file.bytes_max, bytes_max);
    file.mode |= mode;
  };
  add(kManifestName, kManifestBytesMax, kContentMode);
  for (const std::string& path : manifest.rules) add(path, lang::kFileBytesMax, kContentMode);
  for (const std::string& path : manifest.yara) add(path, kBundleBytesMax, kContentMode);
  for (const ManifestPlugin& plugin : manifest.plugins) {
    add(plugin.path, kPluginBytesMax, kPluginMode);
  }
  return files;
}

absl::Status ReadContents(
    const std::string& dir,
    absl::FunctionRef<absl::Status(const ContentFile& file, std::string bytes)> take) {
  RIPS_ASSIGN_OR_RETURN(const BundleDirectory from, BundleDirectory::Open(dir));
  RIPS_ASSIGN_OR_RETURN(const std::string text, from.Read(kManifestName, kManifestBytesMax));
  RIPS_ASSIGN_OR_RETURN(const Manifest manifest,
                        ParseManifest(absl::StrCat(dir, "/", kManifestName), text));
  for (const ContentFile& file : ListContents(manifest)) {
    if (file.path == kManifestName) {
      RIPS_RETURN_IF_ERROR(take(file, text));
      continue;
    }
    RIPS_ASSIGN_OR_RETURN(std::string bytes, from.Read(file.path, file.bytes_max));
    RIPS_RETURN_IF_ERROR(take(file, std::move(bytes)));
  }
  return absl::OkStatus();
}

absl::Status WriteContent(const std::string& dir, const ContentFile& file,
                          absl::string_view bytes) {
  const std::string path = absl::StrCat(dir, "/", file.path);
  std::error_code error;
  fs::create_directories(fs::path(path).parent_path(), error);
  if (error) return FileError(error.value(), "making the directory of", path);
  const UniqueFd fd(open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, file.mode));
  if (fd.get() < 0) return FileError(errno, "creating", path);
  while (!bytes.empty()) {
    const ssize_t wrote = write(fd.get(), bytes.data(), bytes.size());
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote < 0) return FileError(errno, "writing", path);
    bytes.remove_prefix(static_cast<size_t>(wrote));
  }
  if (fsync(fd.get()) != 0) return FileError(errno, "syncing", path);
  return absl::OkStatus();
}

absl::Status SyncDirectories(const std::string& dir) {
  std::error_code error;
  for (fs::recursive_directory_iterator it(dir, error), end; !error && it != end;
       it.increment(error)) {
    if (it->is_directory(error)) RIPS_RETURN_IF_ERROR(SyncPath(it->path().string()));
  }
  if (error) return FileError(error.value(), "syncing", dir);
  return SyncPath(dir);
}

absl::Status SyncPath(const std::string& path) {
  const UniqueFd fd(open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (fd.get() < 0 || fsync(fd.get()) != 0) return FileError(errno, "syncing", path);
  return absl::OkStatus();
}

absl::Status FileError(int error, absl::string_view doing, const std::string& path) {
  const std::string text = absl::StrCat(doing, " `", path, "`: ", std::strerror(error));
  if (error == ENOSPC || error == EDQUOT) return absl::ResourceExhaustedError(text);
  return absl::UnavailableError(text);
}

}  // namespace rips::bundle
