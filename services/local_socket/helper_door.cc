#include "services/local_socket/helper_door.h"

#include <pwd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/local_socket/helper_socket.h"

namespace rips::actuator {
namespace {

std::string DirectoryOf(const std::string& path) {
  const size_t slash = path.rfind('/');
  if (slash == std::string::npos) return ".";
  return slash == 0 ? "/" : path.substr(0, slash);
}

}  // namespace

bool HelperDoor::Trusts(uid_t user) const {
  return user == 0 || user == geteuid() || (run_as_.has_value() && user == *run_as_);
}

absl::Status HelperDoor::NotTrusted(absl::string_view why) const {
  return absl::PermissionDeniedError(absl::StrCat(helper_, ": `", path_, "` is not trusted: ", why,
                                                  "; another process may pose as ", helper_));
}

absl::Status HelperDoor::CheckFiles() const {
  struct stat info;
  const std::string directory = DirectoryOf(path_);
  if (stat(directory.c_str(), &info) != 0) return absl::OkStatus();  // then nothing is there
  if (!Trusts(info.st_uid)) {
    return NotTrusted(absl::StrCat("`", directory, "` belongs to user ", info.st_uid));
  }
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) != 0 && (info.st_mode & S_ISVTX) == 0) {
    return NotTrusted(
        absl::StrCat("others may replace files in `", directory, "`, which is not sticky"));
  }
  if (lstat(path_.c_str(), &info) != 0) return absl::OkStatus();
  if (!S_ISSOCK(info.st_mode)) return NotTrusted("it is no socket");
  if (!Trusts(info.st_uid)) return NotTrusted(absl::StrCat("it belongs to user ", info.st_uid));
  return absl::OkStatus();
}

absl::Status HelperDoor::CheckPeer(int fd) const {
  ucred peer = {};
  socklen_t size = sizeof(peer);
  // Of the process that called listen().
  if (getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0) {
    return NotTrusted(absl::StrCat("no credentials: ", std::strerror(errno)));
  }
  if (!Trusts(peer.uid)) return NotTrusted(absl::StrCat("user ", peer.uid, " listens there"));
  return absl::OkStatus();
}

absl::StatusOr<UniqueFd> HelperDoor::Connect() const {
  RIPS_RETURN_IF_ERROR(CheckFiles());
  RIPS_ASSIGN_OR_RETURN(UniqueFd fd, ConnectToHelper(path_, helper_));
  const absl::Status peer = CheckPeer(fd.get());
  {
    MutexLock lock(&mu_);
    found_ = peer;
  }
  RIPS_RETURN_IF_ERROR(peer);
  return fd;
}

absl::Status HelperDoor::Check() const {
  RIPS_RETURN_IF_ERROR(CheckFiles());
  MutexLock lock(&mu_);
  return found_;
}

absl::StatusOr<std::optional<uid_t>> FindHelperUser(const std::string& configured,
                                                    const std::string& packaged,
                                                    absl::string_view key) {
  if (configured.empty()) {
    const passwd* entry = getpwnam(packaged.c_str());
    return entry == nullptr ? std::nullopt : std::optional<uid_t>(entry->pw_uid);
  }
  RIPS_ASSIGN_OR_RETURN(const uid_t user, FindUser(configured, key));
  return std::optional<uid_t>(user);
}

}  // namespace rips::actuator
