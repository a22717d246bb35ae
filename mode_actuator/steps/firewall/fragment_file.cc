#include "mode_actuator/steps/firewall/fragment_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "absl/strings/str_cat.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {

absl::StatusOr<std::vector<FragmentRule>> ReadFragment(const std::string& path) {
  const auto unsafe = [&](absl::string_view why) {
    return absl::PermissionDeniedError(absl::StrCat("`", path, "` ", why));
  };
  // Not blocking: a FIFO without a writer must not stop us.
  const UniqueFd file(open(path.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK));
  if (file.get() < 0) {
    if (errno == ELOOP) return unsafe("is a symbolic link; name its target");
    const std::string why = absl::StrCat("cannot read `", path, "`: ", std::strerror(errno));
    return errno == ENOENT ? absl::NotFoundError(why) : absl::UnavailableError(why);
  }
  struct stat info;
  if (fstat(file.get(), &info) != 0 || !S_ISREG(info.st_mode)) {
    return unsafe("is no regular file");
  }
  if (info.st_uid != 0 && info.st_uid != geteuid()) return unsafe("is not owned by root");
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) != 0) {
    return unsafe("can be written by others; chmod go-w");
  }
  std::string text;
  char buffer[16 << 10];
  while (text.size() <= kFragmentBytesMax) {
    const ssize_t got = read(file.get(), buffer, sizeof(buffer));
    if (got == 0) break;
    if (got > 0) {
      text.append(buffer, static_cast<size_t>(got));
    } else if (errno != EINTR) {
      return absl::UnavailableError(
          absl::StrCat("cannot read `", path, "`: ", std::strerror(errno)));
    }
  }
  return ParseFragment(path, text);
}

}  // namespace rips::actuator
