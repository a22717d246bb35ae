#include "policy_server/server/store/alert_log.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::store {
namespace {

absl::Status FromErrno(const std::string& doing) {
  const std::string text = absl::StrCat(doing, ": ", std::strerror(errno));
  if (errno == ENOSPC || errno == EDQUOT || errno == EFBIG) {
    return absl::ResourceExhaustedError(text);
  }
  return absl::UnavailableError(text);
}

// Longer than any line of ours.
constexpr off_t kTailBytesMax = 4 << 20;

// The end of the file, at most kTailBytesMax; shorter if it cannot be read.
std::string ReadTail(int fd, off_t size) {
  const off_t from = size > kTailBytesMax ? size - kTailBytesMax : 0;
  std::string tail(static_cast<size_t>(size - from), '\0');
  size_t done = 0;
  while (done < tail.size()) {
    const ssize_t got =
        pread(fd, tail.data() + done, tail.size() - done, from + static_cast<off_t>(done));
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) break;
    done += static_cast<size_t>(got);
  }
  tail.resize(done);
  return tail;
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
  line["decision_id"] = ToString(alert.decision_id);
  line["maintenance"] = alert.maintenance;
  nlohmann::ordered_json subjects = nlohmann::ordered_json::array();
  for (const engine::TracedSubject& subject : alert.trace.subjects) {
    subjects.push_back({{"name", subject.name},
                        {"role", subject.role},
                        {"guid", subject.guid.none() ? "" : ToString(subject.guid)},
                        {"host", subject.host},
                        {"pid", subject.pid},
                        {"address", subject.address}});
  }
  line["subjects"] = std::move(subjects);
  return line.dump(-1, ' ', /*ensure_ascii=*/true, nlohmann::json::error_handler_t::replace);
}

AlertLog::AlertLog(std::string path, AlertLogOptions options)
    : path_(std::move(path)), options_(std::move(options)) {}

absl::StatusOr<std::unique_ptr<AlertLog>> AlertLog::Open(const std::string& path,
                                                         AlertLogOptions options) {
  if (!options.rename_file) {
    options.rename_file = [](const char* from, const char* to) { return rename(from, to); };
  }
  std::unique_ptr<AlertLog> log(new AlertLog(path, std::move(options)));
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
  // A link would be renamed in the place of the file that it names.
  const int no_link = options_.rotate_bytes > 0 ? O_NOFOLLOW : 0;
  const int fd =
      open(path_.c_str(), O_RDWR | O_APPEND | O_CREAT | O_CLOEXEC | O_NOCTTY | no_link, 0640);
  if (fd < 0 && errno == ELOOP && no_link != 0) {
    return absl::UnavailableError(absl::StrCat("alert file `", path_,
                                               "` is a symbolic link, which `rotate_bytes` does "
                                               "not follow; name the file itself"));
  }
  if (fd < 0) return FromErrno(absl::StrCat("opening alert file `", path_, "`"));
  struct stat info = {};
  if (fstat(fd, &info) != 0 || !S_ISREG(info.st_mode)) {
    close(fd);
    return absl::UnavailableError(absl::StrCat("alert file `", path_, "` is not a regular file"));
  }
  if (fd_ >= 0) close(fd_);
  fd_ = fd;
  torn_ = false;
  const std::string tail = ReadTail(fd, info.st_size);
  if (!tail.empty() && tail.back() != '\n') {
    const size_t whole = tail.rfind('\n');
    const size_t cut = whole == std::string::npos ? tail.size() : tail.size() - whole - 1;
    CutLocked(info.st_size - static_cast<off_t>(cut));
  }
  return absl::OkStatus();
}

void AlertLog::CutLocked(off_t size) { torn_ = ftruncate(fd_, size) != 0; }

absl::StatusOr<std::string> AlertLog::LastId() {
  MutexLock lock(&mutex_);
  struct stat info = {};
  if (fstat(fd_, &info) != 0) return FromErrno(absl::StrCat("reading alert file `", path_, "`"));
  const int rotated = info.st_size == 0 ? OpenRotatedLocked() : -1;
  if (rotated >= 0 && fstat(rotated, &info) != 0) info.st_size = 0;
  std::string tail = ReadTail(rotated >= 0 ? rotated : fd_, info.st_size);
  if (rotated >= 0) close(rotated);
  if (!tail.empty() && tail.back() == '\n') tail.pop_back();
  const size_t before = tail.rfind('\n');
  const auto line = nlohmann::json::parse(
      before == std::string::npos ? tail : tail.substr(before + 1), nullptr, false);
  if (!line.is_object() || !line.contains("id") || !line["id"].is_string()) return std::string();
  return line["id"].get<std::string>();
}

int AlertLog::OpenRotatedLocked() const {
  if (options_.rotate_bytes == 0) return -1;
  // Without O_NONBLOCK a pipe in its place would hold us up.
  const int fd = open(RotatedName(path_, 1).c_str(),
                      O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NOFOLLOW | O_NONBLOCK);
  struct stat info = {};
  if (fd < 0 || (fstat(fd, &info) == 0 && S_ISREG(info.st_mode))) return fd;
  close(fd);
  return -1;
}

bool AlertLog::MovedLocked() const {
  struct stat by_path = {};
  struct stat by_fd = {};
  if (stat(path_.c_str(), &by_path) != 0 || fstat(fd_, &by_fd) != 0) return true;
  return by_path.st_dev != by_fd.st_dev || by_path.st_ino != by_fd.st_ino;
}

absl::Status AlertLog::RotateIfFullLocked(size_t line_bytes) {
  struct stat info = {};
  if (options_.rotate_bytes == 0 || fstat(fd_, &info) != 0 || info.st_size == 0) {
    return absl::OkStatus();
  }
  const auto size = static_cast<uint64_t>(info.st_size);
  const bool fits = size <= options_.rotate_bytes && line_bytes <= options_.rotate_bytes - size;
  if (fits) return absl::OkStatus();
  // LastId looks into FILE.1 only if FILE is empty: what moves there must not be lost any more.
  absl::Status rotated = fdatasync(fd_) == 0
                             ? absl::OkStatus()
                             : FromErrno(absl::StrCat("syncing alert file `", path_, "`"));
  if (rotated.ok()) rotated = RotateFile(path_, options_.keep, options_.rename_file);
  if (!rotated.ok()) {
    if (options_.on_rotation_failure) options_.on_rotation_failure();
    if (!std::exchange(rotation_failing_, true)) {
      LogError("cannot rotate the alert file; it grows until that is possible",
               {{"file", path_}, {"reason", rotated.message()}});
    }
    return absl::OkStatus();
  }
  if (std::exchange(rotation_failing_, false)) {
    LogInfo("alert file rotated again", {{"file", path_}});
  }
  return OpenLocked();
}

absl::Status AlertLog::WriteLocked(std::string text) {
  if (torn_) text.insert(text.begin(), '\n');
  struct stat before = {};
  const bool sized = fstat(fd_, &before) == 0;
  size_t done = 0;
  while (done < text.size()) {
    const ssize_t wrote = write(fd_, text.data() + done, text.size() - done);
    if (wrote < 0 && errno == EINTR) continue;
    if (wrote < 0) {
      const absl::Status status = FromErrno(absl::StrCat("writing alert file `", path_, "`"));
      if (done > 0) torn_ = text[done - 1] != '\n';
      if (done > 0 && sized) CutLocked(before.st_size);
      return status;
    }
    done += static_cast<size_t>(wrote);
  }
  torn_ = false;
  return absl::OkStatus();
}

absl::StatusOr<size_t> AlertLog::Append(std::span<const AlertRecord> alerts) {
  if (alerts.empty()) return 0;
  std::vector<std::string> lines;
  for (const AlertRecord& alert : alerts) lines.push_back(FormatAlertLine(alert) + "\n");

  MutexLock lock(&mutex_);
  if (MovedLocked()) RIPS_RETURN_IF_ERROR(OpenLocked());
  size_t written = 0;
  while (written < lines.size()) {
    absl::Status status = RotateIfFullLocked(lines[written].size());
    struct stat info = {};
    if (status.ok() && fstat(fd_, &info) != 0)
      status = FromErrno(absl::StrCat("examining alert file `", path_, "`"));
    // As many as fit go in one write, at least one.
    std::string text = lines[written];
    size_t end = written + 1;
    // A file that is too long could not be rotated.
    const bool any_size = options_.rotate_bytes == 0 ||
                          (info.st_size > 0 && static_cast<uint64_t>(info.st_size) + text.size() >
                                                   options_.rotate_bytes);
    const auto fits = [&](size_t more) {
      return any_size ||
             static_cast<uint64_t>(info.st_size) + text.size() + more <= options_.rotate_bytes;
    };
    while (end < lines.size() && fits(lines[end].size())) text += lines[end++];
    if (status.ok()) status = WriteLocked(std::move(text));
    if (!status.ok() && written == 0) return status;
    if (!status.ok()) return written;
    written = end;
  }
  return written;
}

}  // namespace rips::store
