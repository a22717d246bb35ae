#include "sensor_agent/ids/log_tail.h"

#include <dirent.h>
#include <fcntl.h>
#include <sys/inotify.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "services/base/clock.h"

namespace rips::sensor {

namespace {

constexpr size_t kChunkBytes = 64 * 1024;
// Files whose reading has ended that are remembered, should they come back.
constexpr size_t kFinishedMax = 64;
// So many of a file's first bytes must be the same for it to be what is left of the file. Every
// line begins with its time.
constexpr size_t kSameHeadBytes = 32;
// How long a file that was replaced is read for what comes late.
constexpr int64_t kFormerNs = 5 * kNanosPerSecond;
constexpr uint32_t kDirectoryEvents = IN_CREATE | IN_MOVED_FROM | IN_MOVED_TO | IN_DELETE |
                                      IN_DELETE_SELF | IN_MOVE_SELF | IN_ONLYDIR;

absl::Status ErrnoStatus(absl::string_view what, const std::string& path) {
  return absl::ErrnoToStatus(errno, absl::StrCat("cannot ", what, " `", path, "`"));
}

std::string DirectoryOf(const std::string& path) {
  return path.substr(0, std::max<size_t>(path.rfind('/'), 1));
}

// As many bytes as there are, up to `size`; negative on error.
ssize_t ReadAt(int fd, char* to, size_t size, uint64_t offset) {
  size_t done = 0;
  while (done < size) {
    const ssize_t got = pread(fd, to + done, size - done, static_cast<off_t>(offset + done));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return -1;
    if (got == 0) break;
    done += static_cast<size_t>(got);
  }
  return static_cast<ssize_t>(done);
}

}  // namespace

LogTail::LogTail(std::string path, std::optional<LogPosition> from, LogTailLimits limits)
    : path_(std::move(path)),
      directory_(DirectoryOf(path_)),
      name_(path_.substr(path_.rfind('/') + 1)),
      limits_(limits),
      from_(from),
      inotify_(limits.events ? inotify_init1(IN_NONBLOCK | IN_CLOEXEC) : -1) {}

// --- Opening

uint64_t LogTail::File::Size() const {
  struct stat status;
  if (fstat(fd.get(), &status) != 0 || status.st_size < 0) return 0;
  return static_cast<uint64_t>(status.st_size);
}

absl::StatusOr<LogTail::File> LogTail::Open(const std::string& path) {
  File file;
  // Without waiting for the other end, should it be a pipe.
  file.fd = UniqueFd(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY));
  if (file.fd.get() < 0) return ErrnoStatus("open", path);
  struct stat status;
  if (fstat(file.fd.get(), &status) != 0) return ErrnoStatus("look at", path);
  if (!S_ISREG(status.st_mode)) {
    return absl::FailedPreconditionError(absl::StrCat("`", path, "` is no regular file"));
  }
  file.device = status.st_dev;
  file.inode = status.st_ino;
  return file;
}

bool LogTail::Seek(File& file, uint64_t offset, uint64_t fingerprint) {
  const size_t size = static_cast<size_t>(std::min<uint64_t>(offset, kFingerprintBytes));
  std::string before(size, '\0');
  const ssize_t got = ReadAt(file.fd.get(), before.data(), size, offset - size);
  if (got != static_cast<ssize_t>(size) || Fingerprint(before) != fingerprint) return false;
  // Behind a hole a line begins, too.
  file.skipping = size > 0 && before.back() != '\n' && before.back() != '\0';
  file.begin = file.scanned = size;
  file.buffer = std::move(before);
  file.offset = offset;
  return true;
}

void LogTail::SeekEnd(File& file) const {
  struct stat status;
  if (fstat(file.fd.get(), &status) != 0 || status.st_size <= 0) return;
  const uint64_t end = static_cast<uint64_t>(status.st_size);
  const size_t size = static_cast<size_t>(std::min<uint64_t>(end, kFingerprintBytes));
  std::string before(size, '\0');
  // If it has just been truncated the place is found wrong at the first look, as ever.
  const ssize_t got = ReadAt(file.fd.get(), before.data(), size, end - size);
  if (got != static_cast<ssize_t>(size)) return;
  Seek(file, end, Fingerprint(before));
}

LogPosition LogTail::PositionIn(const File& file, size_t back) {
  const size_t end = file.begin - back;
  const size_t size = std::min(end, kFingerprintBytes);
  return {.device = file.device,
          .inode = file.inode,
          .offset = file.offset - back,
          .fingerprint = Fingerprint(absl::string_view(file.buffer).substr(end - size, size))};
}

std::optional<LogPosition> LogTail::position() const {
  if (file_.has_value()) return PositionIn(*file_);
  return from_;
}

template <typename IsIt>
bool LogTail::Any(const IsIt& is_it) const {
  const std::unique_ptr<DIR, int (*)(DIR*)> directory(opendir(directory_.c_str()), closedir);
  if (directory == nullptr) return false;
  while (const dirent* entry = readdir(directory.get())) {
    struct stat status;
    if (fstatat(dirfd(directory.get()), entry->d_name, &status, 0) != 0) continue;
    if (S_ISREG(status.st_mode) && is_it(entry->d_name, status)) return true;
  }
  return false;
}

template <typename IsIt>
std::optional<LogTail::File> LogTail::Find(const LogPosition& position, const IsIt& is_it) const {
  std::optional<File> found;
  Any([&](absl::string_view name, const struct stat& status) {
    if (!is_it(name, status)) return false;
    absl::StatusOr<File> file = Open(absl::StrCat(directory_, "/", name));
    if (!file.ok() || file->inode != status.st_ino ||
        !Seek(*file, position.offset, position.fingerprint)) {
      return false;
    }
    found = *std::move(file);
    return true;
  });
  return found;
}

std::optional<LogTail::File> LogTail::FindRenamed(const LogPosition& position) const {
  return Find(position, [&](absl::string_view, const struct stat& status) {
    return status.st_ino == position.inode;
  });
}

std::optional<LogTail::File> LogTail::FindCopy(const LogPosition& position) const {
  // Without a byte before it, everything is a copy.
  if (position.offset == 0) return std::nullopt;
  return Find(position, [&](absl::string_view name, const struct stat&) {
    return absl::StartsWith(name, name_) && name != name_;
  });
}

bool LogTail::HasLater(const File& file) const {
  struct stat ours;
  if (fstat(file.fd.get(), &ours) != 0) return false;
  return Any([&](absl::string_view name, const struct stat& status) {
    return absl::StartsWith(name, name_) && name != name_ && status.st_ino != ours.st_ino &&
           std::pair(status.st_mtim.tv_sec, status.st_mtim.tv_nsec) >
               std::pair(ours.st_mtim.tv_sec, ours.st_mtim.tv_nsec);
  });
}

absl::StatusOr<LogTail::File> LogTail::GoOn(absl::StatusOr<File> file) {
  const LogPosition& from = *from_;
  if (from.inode == 0) return file;
  if (file.ok() && file->inode == from.inode && Seek(*file, from.offset, from.fingerprint)) {
    return file;
  }
  if (std::optional<File> renamed = FindRenamed(from); renamed.has_value()) {
    // Those in between have been read by nobody, and which they are is a guess.
    if (HasLater(*renamed)) ++counters_.gaps;
    return *std::move(renamed);
  }
  // Without a byte before it, everything is a copy.
  if (file.ok() && from.offset > 0 && Seek(*file, from.offset, from.fingerprint)) return file;
  if (std::optional<File> copy = FindCopy(from); copy.has_value()) {
    SetFormer(*std::move(copy));
  } else {
    ++counters_.gaps;
  }
  return file;
}

void LogTail::Begin() {
  absl::StatusOr<File> file = Open(path_);
  status_ = file.status();
  // What cannot be read now may be old.
  if (!file.ok() && !absl::IsNotFound(status_)) return;
  // Renamings until here are of old files; if ours is one of them this is tried again.
  TakeEvents();
  if (file.ok() && !IsAtPath(*file)) return;
  begun_ = true;
  unseen_ = false;
  if (from_.has_value()) {
    file = GoOn(std::move(file));
  } else if (file.ok()) {
    SeekEnd(*file);
  }
  if (file.ok()) {
    file_ = *std::move(file);
    WatchFile();
  } else {
    from_.emplace();
  }
}

bool LogTail::IsAtPath(const File& file) const {
  struct stat status;
  return stat(path_.c_str(), &status) == 0 && status.st_ino == file.inode &&
         status.st_dev == file.device;
}

bool LogTail::OpenFirst() {
  absl::StatusOr<File> file = Open(path_);
  status_ = file.status();
  TakeEvents();  // what was renamed away before comes first
  if (!rotated_.empty()) {
    file = std::move(rotated_.front());
    rotated_.pop_front();
  }
  if (!file.ok()) return false;
  file_ = *std::move(file);
  unseen_ = false;
  WatchFile();
  return true;
}

// --- Watching

void LogTail::Watch() {
  if (directory_watch_ >= 0 || inotify_.get() < 0) return;
  directory_watch_ = inotify_add_watch(inotify_.get(), directory_.c_str(), kDirectoryEvents);
}

void LogTail::WatchFile() {
  head_.clear();
  changes_.Stop();
  if (inotify_.get() < 0) return;
  changes_.Watch(file_->fd.get());
  // The file that is open, whatever its name is by now.
  const std::string opened = absl::StrCat("/proc/self/fd/", file_->fd.get());
  const int watch = inotify_add_watch(inotify_.get(), opened.c_str(), IN_MODIFY);
  if (file_watch_ >= 0 && watch != file_watch_) inotify_rm_watch(inotify_.get(), file_watch_);
  file_watch_ = watch;
}

void LogTail::TakeEvents() {
  if (inotify_.get() < 0) return;
  alignas(inotify_event) char events[16 * 1024];
  // Names, in the order in which they were renamed away from ours, as they are now.
  std::vector<std::string> rotated;
  std::map<uint32_t, std::string> moving;
  while (true) {
    const ssize_t size = read(inotify_.get(), events, sizeof(events));
    if (size <= 0) break;
    for (const char* at = events; at < events + size;) {
      const auto* event = reinterpret_cast<const inotify_event*>(at);
      at += sizeof(inotify_event) + event->len;
      if ((event->mask & IN_Q_OVERFLOW) != 0) ++counters_.gaps;
      if (event->wd != directory_watch_) continue;
      if ((event->mask & (IN_DELETE_SELF | IN_MOVE_SELF | IN_IGNORED)) != 0) {
        if ((event->mask & IN_MOVE_SELF) != 0) inotify_rm_watch(inotify_.get(), event->wd);
        directory_watch_ = -1;
        continue;
      }
      const std::string name = event->len > 0 ? std::string(event->name) : "";
      if (name == name_) {
        // Gone before it was looked at. One that is renamed away is found by its new name.
        if (begun_ && unseen_ && (event->mask & (IN_DELETE | IN_MOVED_TO)) != 0) ++counters_.gaps;
        unseen_ = (event->mask & (IN_CREATE | IN_MOVED_TO)) != 0;
      }
      if ((event->mask & IN_MOVED_FROM) != 0) moving[event->cookie] = name;
      if ((event->mask & IN_MOVED_TO) == 0) continue;
      const auto from = moving.find(event->cookie);
      if (from == moving.end()) continue;
      // What had this name is overwritten.
      rotated.erase(std::remove(rotated.begin(), rotated.end(), name), rotated.end());
      if (from->second == name_) rotated.push_back(name);
      std::replace(rotated.begin(), rotated.end(), from->second, name);
      moving.erase(from);
    }
  }
  for (const std::string& name : rotated) Enqueue(name);
}

void LogTail::Enqueue(const std::string& name) {
  // Before the beginning, that looks at everything that is there.
  if (!begun_) return;
  absl::StatusOr<File> file = Open(absl::StrCat(directory_, "/", name));
  if (!file.ok()) {
    // Removed as well, which does not matter if it is the one that is being read.
    struct stat status;
    const bool ours =
        file_.has_value() && fstat(file_->fd.get(), &status) == 0 && status.st_nlink == 0;
    if (!ours) ++counters_.gaps;
    return;
  }
  const auto is_it = [&](const File& each) {
    return each.inode == file->inode && each.device == file->device;
  };
  if (file_.has_value() && is_it(*file_)) return;
  if (former_.has_value() && is_it(*former_)) return;
  if (std::any_of(rotated_.begin(), rotated_.end(), is_it)) return;
  if (rotated_.size() >= limits_.rotated_files && rotated_.front().Size() > 0) {
    ++counters_.gaps;
    return;
  }
  if (rotated_.size() >= limits_.rotated_files) rotated_.pop_front();
  rotated_.push_back(*std::move(file));
}

// --- Reading

bool LogTail::GoToRemainder(File& file) {
  const uint64_t size = file.Size();
  if (head_.size() < kSameHeadBytes || size < kSameHeadBytes || size >= file.ReadTo()) return false;
  std::string head(static_cast<size_t>(std::min<uint64_t>(size, head_.size())), '\0');
  const ssize_t got = ReadAt(file.fd.get(), head.data(), head.size(), 0);
  if (got != static_cast<ssize_t>(head.size()) || !absl::StartsWith(head_, head)) return false;
  SeekEnd(file);
  return true;
}

void LogTail::RememberHead() {
  const uint64_t read_to = file_->ReadTo();
  const auto size = static_cast<size_t>(std::min<uint64_t>(read_to, kFingerprintBytes));
  if (head_.size() >= size) return;
  head_.resize(size);
  const ssize_t got = ReadAt(file_->fd.get(), head_.data(), size, 0);
  if (got != static_cast<ssize_t>(size) || file_->Size() < read_to) head_.clear();
}

void LogTail::StartOver(File& file) {
  ++counters_.truncated;
  std::optional<File> copy = FindCopy(PositionIn(file));
  const uint64_t read_to = file.ReadTo();
  const bool unfinished = file.buffer.size() > file.begin;
  const bool remainder = GoToRemainder(file);
  // One that ends where we were is of an earlier time, or there was nothing more.
  const bool more = copy.has_value() && copy->Size() > read_to;
  // What stands there now came by a write of its own. Its length first: it may grow.
  const bool written = !remainder && file.Size() > 0;
  changes_.Look();
  const std::optional<uint64_t>& changes = changes_.changes();
  if (!more && (!changes.has_value() || *changes > (written ? 2 : 1))) ++counters_.gaps;
  if (copy.has_value()) {
    SetFormer(*std::move(copy));
  } else if (unfinished || (remainder && file.skipping)) {
    ++counters_.cut_off;
  }
  changes_.Forget();
  head_.clear();
  if (remainder) return;
  file.buffer.clear();
  file.begin = file.scanned = 0;
  file.offset = 0;
  file.skipping = false;
}

void LogTail::Lines(File& file, const OnLine& on_line) {
  while (true) {
    const void* found =
        memchr(file.buffer.data() + file.scanned, '\n', file.buffer.size() - file.scanned);
    if (found == nullptr) break;
    const size_t end = static_cast<size_t>(static_cast<const char*>(found) - file.buffer.data());
    absl::string_view line = absl::string_view(file.buffer).substr(file.begin, end - file.begin);
    file.offset += line.size() + 1;
    file.begin = file.scanned = end + 1;
    line_bytes_ = file_.has_value() && &file == &*file_ ? line.size() + 1 : 0;
    if (std::exchange(file.skipping, false)) continue;
    // A writer that goes on where it was leaves a hole in a truncated file.
    while (!line.empty() && line.front() == '\0') line.remove_prefix(1);
    if (line.size() > limits_.line_bytes) {
      ++counters_.too_long;
      continue;
    }
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    on_line(line);
  }
  file.scanned = file.buffer.size();
  const size_t unfinished = file.buffer.size() - file.begin;
  const bool hole = unfinished > 0 && file.buffer[file.begin] == '\0' &&
                    file.buffer.find_first_not_of('\0', file.begin) == std::string::npos;
  if (hole || file.skipping || unfinished > limits_.line_bytes) {
    if (!hole && !std::exchange(file.skipping, true)) ++counters_.too_long;
    file.offset += unfinished;
    file.begin = file.buffer.size();
  }
  if (file.begin > kFingerprintBytes) {
    const size_t gone = file.begin - kFingerprintBytes;
    file.buffer.erase(0, gone);
    file.begin -= gone;
    file.scanned -= gone;
  }
}

bool LogTail::ReadFile(File& file, const OnLine& on_line, size_t& budget) {
  std::string chunk;
  while (budget > 0) {
    // The last bytes again: if they are others now, so is the file.
    const size_t known = std::min(file.buffer.size(), kFingerprintBytes);
    const uint64_t read_to = file.ReadTo();
    chunk.resize(known + std::min(budget, kChunkBytes));
    const ssize_t got = ReadAt(file.fd.get(), chunk.data(), chunk.size(), read_to - known);
    if (got < 0) {
      status_ = ErrnoStatus("read", path_);
      return false;
    }
    const absl::string_view bytes = absl::string_view(chunk).substr(0, static_cast<size_t>(got));
    const absl::string_view last =
        absl::string_view(file.buffer).substr(file.buffer.size() - known);
    if (bytes.substr(0, known) != last) {
      if (former_.has_value() && &file == &*former_) {
        DropFormer();  // what it has now is no log of ours
        return false;
      }
      StartOver(file);
      return true;
    }
    const absl::string_view fresh = bytes.substr(known);
    if (fresh.empty()) return false;
    budget -= fresh.size();
    file.buffer.append(fresh.data(), fresh.size());
    Lines(file, on_line);
  }
  return true;
}

void LogTail::DropFormer() {
  if (!former_.has_value()) return;
  if (former_->buffer.size() > former_->begin) ++counters_.cut_off;
  if (finished_.size() >= kFinishedMax) finished_.pop_front();
  finished_.push_back(PositionIn(*former_));
  former_.reset();
}

void LogTail::SetFormer(File file) {
  DropFormer();
  former_ = std::move(file);
  former_until_ns_ = now_ns_ + kFormerNs;
}

bool LogTail::SeekRead(File& file) const {
  for (auto it = finished_.rbegin(); it != finished_.rend(); ++it) {
    if (it->inode == file.inode && it->device == file.device &&
        Seek(file, it->offset, it->fingerprint)) {
      return true;
    }
  }
  return false;
}

void LogTail::Replace(File next) {
  const LogPosition here = PositionIn(*file_);
  if (former_.has_value() && former_->inode == next.inode && former_->device == next.device) {
    // Renamed back.
    std::swap(*former_, *file_);
  } else if (SeekRead(next)) {
    SetFormer(*std::exchange(file_, std::move(next)));
  } else if (here.offset > 0 && Seek(next, here.offset, here.fingerprint)) {
    // An editor's, or another copy: what was read stays read.
    file_ = std::move(next);
  } else {
    SetFormer(*std::exchange(file_, std::move(next)));
  }
  WatchFile();
}

bool LogTail::Follow() {
  struct stat status;
  std::optional<File> next;
  if (stat(path_.c_str(), &status) != 0) {
    status_ = ErrnoStatus("look at", path_);
  } else if ((status.st_ino != file_->inode || status.st_dev != file_->device) &&
             status.st_size > 0) {
    absl::StatusOr<File> opened = Open(path_);
    if (opened.ok()) next = *std::move(opened);
    status_ = opened.status();
  }
  // After the opening: what was renamed away before it is in `rotated_` now, and comes first.
  const bool looked = status_.ok();
  TakeEvents();
  if (looked) unseen_ = false;
  // A writer that was not told of the renaming goes on in ours, and leaves the others empty.
  const auto written = std::find_if(rotated_.begin(), rotated_.end(),
                                    [](const File& each) { return each.Size() > 0; });
  if (written != rotated_.end()) {
    next = std::move(*written);
    rotated_.erase(rotated_.begin(), written + 1);
  } else if (next.has_value()) {
    rotated_.clear();
  }
  // It may have become ours again since it was looked at.
  if (!next.has_value() || (next->inode == file_->inode && next->device == file_->device)) {
    return false;
  }
  Replace(*std::move(next));
  return true;
}

bool LogTail::Read(int64_t now_ns, const OnLine& on_line) {
  now_ns_ = now_ns;
  Watch();
  TakeEvents();
  if (!begun_) Begin();
  if (!begun_) return false;
  if (!file_.has_value() && !OpenFirst()) return false;
  status_ = absl::OkStatus();
  changes_.Look();
  size_t budget = limits_.turn_bytes;
  // What was written to it before the first byte of the next one comes before that.
  if (former_.has_value()) {
    if (ReadFile(*former_, on_line, budget)) return true;
    if (now_ns_ >= former_until_ns_) DropFormer();
  }
  if (ReadFile(*file_, on_line, budget)) return true;
  // Written and truncated again, with nothing of it read.
  const bool untouched = file_->offset == 0 && file_->buffer.empty();
  if (untouched && changes_.changes().value_or(0) > 1 && file_->Size() == 0) ++counters_.gaps;
  if (status_.ok()) changes_.WasReadToEnd();
  RememberHead();
  return Follow();
}

}  // namespace rips::sensor
