#include "policy_server/server/store/disk_reserve.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::store {

absl::StatusOr<DiskReserve> DiskReserve::Open(const std::string& path, int64_t bytes) {
  UniqueFd fd(open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (fd.get() < 0) {
    return absl::UnavailableError(
        absl::StrCat("opening reserve `", path, "`: ", std::strerror(errno)));
  }
  struct stat info = {};
  if (fstat(fd.get(), &info) != 0 || !S_ISREG(info.st_mode)) {
    return absl::FailedPreconditionError(
        absl::StrCat("reserve `", path, "` is not a regular file"));
  }
  DiskReserve reserve(std::move(fd), bytes);
  // What is allocated, not what it is long: a hole holds nothing.
  reserve.held_ = std::min<int64_t>(info.st_size, int64_t{info.st_blocks} * 512);
  reserve.Refill().IgnoreError();
  return reserve;
}

bool DiskReserve::Release() {
  if (held_ == 0) return false;
  const int64_t left = held_ > kPieceBytes ? held_ - kPieceBytes : 0;
  if (ftruncate(fd_.get(), left) != 0) return false;
  held_ = left;
  released_ = true;
  return true;
}

absl::Status DiskReserve::Refill() {
  if (held_ >= bytes_) return absl::OkStatus();
  // Blocks, without writing them; the result is an errno.
  const int failed = posix_fallocate(fd_.get(), 0, bytes_);
  if (failed == 0) {
    held_ = bytes_;
    released_ = false;
    return absl::OkStatus();
  }
  // Some file systems keep what they found before they ran out.
  if (ftruncate(fd_.get(), held_) != 0) held_ = 0;
  if (!released_) return absl::OkStatus();
  return absl::ResourceExhaustedError(
      absl::StrCat("the disk has no room for the reserve of ", bytes_ >> 20,
                   " MiB that is kept for decisions: ", std::strerror(failed)));
}

}  // namespace rips::store
