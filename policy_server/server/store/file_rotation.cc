#include "policy_server/server/store/file_rotation.h"

#include <sys/stat.h>

#include <cerrno>
#include <cstring>

#include "absl/strings/str_cat.h"

namespace rips::store {
namespace {

enum class Slot { kFree, kFile, kOther };

Slot Examine(const std::string& path) {
  struct stat info = {};
  if (lstat(path.c_str(), &info) != 0) return errno == ENOENT ? Slot::kFree : Slot::kOther;
  return S_ISREG(info.st_mode) ? Slot::kFile : Slot::kOther;
}

}  // namespace

std::string RotatedName(const std::string& path, int number) {
  return number == 0 ? path : absl::StrCat(path, ".", number);
}

absl::Status RotateFile(const std::string& path, int keep, const RenameFile& rename_file) {
  int to = 1;
  for (;; ++to) {
    const std::string name = RotatedName(path, to);
    const Slot slot = Examine(name);
    if (slot == Slot::kOther) {
      return absl::FailedPreconditionError(
          absl::StrCat("`", name, "` is in the way: it is not a regular file; move it away"));
    }
    if (slot == Slot::kFree || to == keep) break;
  }
  for (; to > 0; --to) {
    const std::string from = RotatedName(path, to - 1);
    if (rename_file(from.c_str(), RotatedName(path, to).c_str()) == 0) continue;
    return absl::UnavailableError(absl::StrCat("cannot rename `", from, "` to `",
                                               RotatedName(path, to), "`: ", std::strerror(errno)));
  }
  return absl::OkStatus();
}

}  // namespace rips::store
