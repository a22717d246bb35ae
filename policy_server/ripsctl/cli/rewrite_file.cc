#include "policy_server/ripsctl/cli/rewrite_file.h"

#include <errno.h>
#include <sys/stat.h>

#include <cstring>
#include <filesystem>
#include <system_error>

#include "absl/strings/str_cat.h"
#include "services/runtime/atomic_file.h"

namespace rips::ripsctl {

absl::Status RewriteFile(const std::string& path, absl::string_view text) {
  std::error_code error;
  const std::string target = std::filesystem::canonical(path, error).string();
  if (error) return absl::UnavailableError(absl::StrCat(path, ": ", error.message()));
  struct stat status = {};
  if (stat(target.c_str(), &status) != 0) {
    return absl::UnavailableError(absl::StrCat(path, ": ", std::strerror(errno)));
  }
  return WriteFileAtomically(target, text, status.st_mode & 07777);
}

}  // namespace rips::ripsctl
