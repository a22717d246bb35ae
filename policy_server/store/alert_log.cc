#include "policy_server/store/alert_log.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "services/base/status_macros.h"

namespace rips::store {
namespace {

absl::Status FromErrno(const std::string& doing) {
  const std::string text = absl::StrCat(doing, ": ", std::strerror(errno));
  if (errno == ENOSPC || errno == EDQUOT || errno == EFBIG) {
    return absl::ResourceExhaustedError(text);
  }
  return absl::UnavailableError(text);
}

bool EndsInsideALine(int fd, off_t size) {
  char last = '\n';
  return size > 0 && pread(fd, &last, 1, size - 1) == 1 && last != '\n';
}

}  // namespace

std::string FormatAlertLine(const AlertRecord& alert) {
  nlohmann::ordered_json line;
  line["id"] = alert.id;
  line["time"] = absl::FormatTime("%Y-%m-%dT%H:%M:%E9SZ", absl::FromUnixNanos(alert.time_unix_ns),
                                  absl::UTCTimeZone());
  line["robot"] = alert.robot;
  line["rule"] = alert.rule;
  line["severity"] = alert.severity;
  line["text"] = alert.text;
  line["level"] = alert.level;
  line["event"] = alert.event;
  line["mark"] = ToString(alert.mark);
  return line.dump(-1, ' ', /*ensure_ascii=*/true, nlohmann::json::error_handler_t::replace);
}

absl::StatusOr<std::unique_ptr<AlertLog>> AlertLog::Open(const std::string& path) {
  std::unique_ptr<AlertLog> log(new AlertLog(path));
  RIPS_RETURN_IF_ERROR(log->Reopen());
  return log;
}

AlertLog::~AlertLog() {
  if (fd_ >= 0) close(fd_);
}

absl::Status AlertLog::Reopen() {
  MutexLock lock(&mutex_);
  return OpenLocked();
}

absl::Status AlertLog::OpenLocked() {
  // Readable, because the last byte tells whether the last line is whole.
  const int fd = open(path_.c_str(), O_RDWR | O_APPEND | O_CREAT | O_CLOEXEC | O_NOCTTY, 0640);
  if (fd < 0) return FromErrno(absl::StrCat("opening alert file `", path_, "`"));
  struct stat info = {};
  if (fstat(fd, &info) != 0 || !S_ISREG(info.st_mode)) {
    close(fd);
    return absl::UnavailableError(absl::StrCat("alert file `", path_, "` is not a regular file"));
  }
  if (fd_ >= 0) close(fd_);
  fd_ = fd;
  torn_ = EndsInsideALine(fd, info.st_size);
  return absl::OkStatus();
}

bool AlertLog::MovedLocked() const {
  struct stat by_path = {};
  struct stat by_fd = {};
  if (stat(path_.c_str(), &by_path) != 0 || fstat(fd_, &by_fd) != 0) return true;
  return by_path.st_dev != by_fd.st_dev || by_path.st_ino != by_fd.st_ino;
}

absl::Status AlertLog::Append(std::span<const AlertRecord> alerts) {
  if (alerts.empty()) return absl::OkStatus();
  std::string text;
  for (const AlertRecord& alert : alerts) absl::StrAppend(&text, FormatAlertLine(alert), "\n");

  MutexLock lock(&mutex_);
  if (MovedLocked()) RIPS_RETURN_IF_ERROR(OpenLocked());
  if (torn_) text.insert(text.begin(), '\n');
  size_t done = 0;
  while (done < text.size()) {
    const ssize_t wrote = write(fd_, text.data() + done, text.size() - done);
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote < 0) {
      const absl::Status status = FromErrno(absl::StrCat("writing alert file `", path_, "`"));
      if (done > 0) torn_ = text[done - 1] != '\n';
      return status;
    }
    done += static_cast<size_t>(wrote);
  }
  torn_ = false;
  return absl::OkStatus();
}

}  // namespace rips::store
