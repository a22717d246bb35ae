#include "policy_server/policy/bundle/bundle_keep.h"

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/bundle/bundle_contents.h"
#include "policy_server/policy/bundle/bundle_signature.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/mutex.h"

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

// Held while copies are made or removed: pushed ones and the directory's come on different threads.
Mutex& CopiesMutex() {
  static Mutex mu;
  return mu;
}

// All that the manifest lists, and `signature` if that is not empty, into `to`, which is not there
// yet.
absl::Status CopyBundle(const std::string& dir, const std::string& to,
                        absl::string_view signature) {
  RIPS_RETURN_IF_ERROR(ReadContents(dir, [&](const ContentFile& file, absl::string_view bytes) {
    return WriteContent(to, file, bytes);
  }));
  if (!signature.empty()) {
    RIPS_RETURN_IF_ERROR(WriteContent(to, {.path = kSignatureName}, signature));
  }
  return SyncDirectories(to);
}

// Makes the copy at `path` anew.
absl::Status MakeCopy(const std::string& dir, absl::string_view id, absl::string_view signature,
                      const std::string& path) {
  std::error_code error;
  const fs::path keep_dir = fs::path(path).parent_path();
  fs::create_directories(keep_dir, error);
  if (error) return FileError(error.value(), "making", keep_dir.string());
  const std::string fresh =
      (keep_dir / absl::StrCat(kHalfMade, fs::path(path).filename().string())).string();
  fs::remove_all(fresh, error);
  absl::Status status = CopyBundle(dir, fresh, signature);
  if (status.ok() && CheckBundle(fresh).id != id) {
    status = absl::AbortedError(absl::StrCat("`", dir, "` was changed while it was copied"));
  }
  if (status.ok()) {
    fs::remove_all(path, error);  // a damaged one
    fs::rename(fresh, path, error);
    if (error) status = FileError(error.value(), "renaming", fresh);
  }
  if (!status.ok()) {
    fs::remove_all(fresh, error);
    return status;
  }
  return SyncPath(keep_dir.string());
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
  MutexLock lock(&CopiesMutex());
  const absl::StatusOr<std::string> source = ReadSignature(dir);
  const std::string kept = ReadSignature(path).value_or("");
  const std::string signature = source.ok() && !source->empty() ? *source : kept;
  std::error_code error;
  if (!fs::exists(path, error) || CheckBundle(path).id != id) {
    RIPS_RETURN_IF_ERROR(MakeCopy(dir, id, signature, path));
  } else if (signature != kept) {
    RIPS_RETURN_IF_ERROR(
        WriteFileAtomically(absl::StrCat(path, "/", kSignatureName), signature, kContentMode));
  }
  if (source.ok()) return absl::OkStatus();
  return absl::Status(source.status().code(), absl::StrCat("it is kept, but not its signature: ",
                                                           source.status().message()));
}

void ForgetBundles(const std::string& keep_dir, const std::set<std::string>& in_use) {
  MutexLock lock(&CopiesMutex());
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
