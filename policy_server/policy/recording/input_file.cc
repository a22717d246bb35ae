#include "policy_server/policy/recording/input_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::recording {
namespace {

constexpr size_t kBufferBytes = 64 * 1024;

absl::Status ErrnoStatus(absl::string_view what, const std::string& path) {
  const absl::Status status =
      absl::ErrnoToStatus(errno, absl::StrCat("cannot ", what, " `", path, "`"));
  if (absl::IsNotFound(status) || absl::IsPermissionDenied(status)) return status;
  return absl::UnavailableError(status.message());
}

}  // namespace

InputFile::InputFile(int fd, std::string path, uint64_t size)
    : fd_(fd), path_(std::move(path)), size_(size) {}

InputFile::~InputFile() { close(fd_); }

absl::StatusOr<std::unique_ptr<InputFile>> InputFile::Open(const std::string& path) {
  // O_NONBLOCK: opening a FIFO must not hang.
  const int fd = open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0) return ErrnoStatus("open", path);
  struct stat info {};
  const bool known = fstat(fd, &info) == 0;
  if (!known || !S_ISREG(info.st_mode)) {
    const absl::Status status =
        known ? absl::FailedPreconditionError(absl::StrCat("`", path, "` is not a regular file"))
              : ErrnoStatus("read", path);
    close(fd);
    return status;
  }
  return std::unique_ptr<InputFile>(new InputFile(fd, path, static_cast<uint64_t>(info.st_size)));
}

absl::Status InputFile::Damaged(uint64_t at, absl::string_view what) const {
  return absl::DataLossError(absl::StrCat("`", path_, "`: byte ", at, ": ", what));
}

absl::Status InputFile::Fill() {
  if (used_ < buffer_.size()) return absl::OkStatus();
  used_ = 0;
  buffer_.resize(static_cast<size_t>(std::min<uint64_t>(kBufferBytes, remaining())));
  while (true) {
    const ssize_t count = pread(fd_, buffer_.data(), buffer_.size(), static_cast<off_t>(offset_));
    if (count < 0 && errno == EINTR) continue;
    const absl::Status status =
        count < 0 ? ErrnoStatus("read", path_) : Damaged(offset_, "the file became shorter");
    buffer_.resize(static_cast<size_t>(std::max<ssize_t>(count, 0)));
    return count > 0 ? absl::OkStatus() : status;
  }
}

absl::Status InputFile::Read(uint64_t count, std::string* out) {
  if (count > remaining()) {
    return Damaged(offset_, absl::StrCat("the file ends here: ", count, " bytes expected, ",
                                         remaining(), " left"));
  }
  out->clear();
  out->reserve(static_cast<size_t>(count));
  while (out->size() < count) {
    RIPS_RETURN_IF_ERROR(Fill());
    const size_t take = std::min(static_cast<size_t>(count) - out->size(), buffer_.size() - used_);
    out->append(buffer_, used_, take);
    used_ += take;
    offset_ += take;
  }
  return absl::OkStatus();
}

absl::StatusOr<bool> InputFile::ReadLine(size_t bytes_max, std::string* line) {
  line->clear();
  while (remaining() > 0) {
    RIPS_RETURN_IF_ERROR(Fill());
    const size_t end = buffer_.find('\n', used_);
    const size_t take = (end == std::string::npos ? buffer_.size() : end + 1) - used_;
    if (line->size() + take > bytes_max) {
      return absl::ResourceExhaustedError(absl::StrCat(
          "`", path_, "`: byte ", offset_, ": a line exceeds the limit of ", bytes_max, " bytes"));
    }
    line->append(buffer_, used_, take);
    used_ += take;
    offset_ += take;
    if (end != std::string::npos) return true;
  }
  return !line->empty();
}

void InputFile::Rewind() {
  offset_ = 0;
  used_ = 0;
  buffer_.clear();
}

}  // namespace rips::recording
