// Follows one growing log file line by line, through everything that is done to logs:
//
// | what happens                          | what is read                                          |
// |---------------------------------------|-------------------------------------------------------|
// | renamed, a new file in its place      | the old one to its end, then the new one from 0       |
// | renamed several times between looks   | each in turn, unless it is gone by then (a gap)       |
// | unlinked                              | the unlinked one, until there is a new one            |
// | copied and truncated                  | the rest of the copy beside it, then again from 0     |
// | truncated, and no copy is beside it   | from 0; a gap, unless nothing can have been unread    |
// | truncated to a part of what was read  | on from its new end; a gap likewise                   |
// | deleted and made again between looks  | the last one; a gap for each between                  |
// | renamed back                          | on from where it was read to                          |
// | replaced by a copy of itself          | on from the same offset                               |
// | replaced by something else            | from 0                                                |
// | not there, or its directory           | from 0 when it comes                                  |
// | any of this while nobody reads        | as above; a gap if what was not read cannot be found  |
//
// A new file counts from its first byte on: until then the writer has not come over, and the old
// one goes on. Afterwards the old one is still read for a few seconds. A truncation shows even if
// the file has grown again: the bytes before the place read up to are others then.
//
// Nothing can have been unread at a truncation if the file had been read to its end and has changed
// but once since (change_counter.h), or twice if something stands in it again: the truncation, and
// the write after it. That holds for a rotation of a log that is being followed; it is a gap if the
// log is written at the very moment, if this process did not run, or if the kernel gives no events.
//
// Not thread-safe.
#ifndef RIPS_SENSOR_AGENT_IDS_LOG_TAIL_H_
#define RIPS_SENSOR_AGENT_IDS_LOG_TAIL_H_

#include <sys/stat.h>

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "sensor_agent/ids/change_counter.h"
#include "sensor_agent/ids/log_position.h"
#include "services/runtime/unique_fd.h"

namespace rips::sensor {

struct LogTailLimits {
  // A longer line is dropped and counted.
  size_t line_bytes = size_t{1} << 20;
  // Read at most so much in one Read; a little more if a line needs it.
  size_t turn_bytes = size_t{1} << 20;
  // Renamed files that wait to be read; beyond is a gap.
  size_t rotated_files = 16;
  // Ask the kernel for events. Without, or where it has none left, wake_fd is -1, and of several
  // renamings between two looks only the first and the last file are read.
  bool events = true;
};

struct LogTailCounters {
  uint64_t too_long = 0;
  // Lines that lost their end or their beginning to a truncation or replacement.
  uint64_t cut_off = 0;
  // Times that something may have been written which was not read and cannot be any more.
  uint64_t gaps = 0;
  // Times that a file was truncated, whether or not something was lost.
  uint64_t truncated = 0;
};

class LogTail {
 public:
  using OnLine = std::function<void(absl::string_view line)>;

  // `path` is absolute. Goes on at `from`; nullopt = at the end of what is there at the first Read,
  // whose lines are old. Nothing is opened yet.
  LogTail(std::string path, std::optional<LogPosition> from, LogTailLimits limits = {});

  // Gives `on_line` the complete lines that have come, without line break, in order. True if there
  // is more to read at once. `now_ns` is CLOCK_BOOTTIME.
  bool Read(int64_t now_ns, const OnLine& on_line);

  // Behind the last line given. Nullopt until it is known where to begin.
  std::optional<LogPosition> position() const;
  // Only within on_line: before that line. For a late line of a file that was replaced: in the file
  // that took its place.
  LogPosition line_position() const { return PositionIn(*file_, line_bytes_); }
  // OK while a file is being followed that is there; else why it is not.
  const absl::Status& status() const { return status_; }
  const LogTailCounters& counters() const { return counters_; }
  // Becomes readable when there may be something to do; Read empties it. Not everything shows here
  // (a network file system, a link to another directory): look each second anyway.
  int wake_fd() const { return inotify_.get(); }
  const std::string& path() const { return path_; }

 private:
  // An open file and what of it has been read.
  struct File {
    UniqueFd fd;
    uint64_t device = 0;
    uint64_t inode = 0;
    // [0, begin) are the last bytes before `offset`, at most kFingerprintBytes between calls; the
    // rest is the beginning of a line.
    std::string buffer;
    size_t begin = 0;
    // No line break in buffer[begin, scanned).
    size_t scanned = 0;
    // In the file, of buffer[begin].
    uint64_t offset = 0;
    // In a line that is not given: too long, or begun before we were there.
    bool skipping = false;

    // 0 also if that is not known.
    uint64_t Size() const;
    // In the file, behind what was read.
    uint64_t ReadTo() const { return offset + (buffer.size() - begin); }
  };

  static absl::StatusOr<File> Open(const std::string& path);
  // Takes `file` to `offset` if what is before that has this fingerprint.
  static bool Seek(File& file, uint64_t offset, uint64_t fingerprint);
  // `back` bytes before what was read.
  static LogPosition PositionIn(const File& file, size_t back = 0);
  // At its end, or behind the end's unfinished line.
  void SeekEnd(File& file) const;
  void Begin();
  // The file that `from_` is in: at the path (`file`), renamed beside it, or copied.
  absl::StatusOr<File> GoOn(absl::StatusOr<File> file);
  bool IsAtPath(const File& file) const;
  // The file that came after there was none; false while there is none.
  bool OpenFirst();
  std::optional<File> FindRenamed(const LogPosition& position) const;
  // A file beside ours, named after it, with the same bytes before the position: what was copied
  // before ours was truncated.
  std::optional<File> FindCopy(const LogPosition& position) const;
  // Files named after ours were written after this one.
  bool HasLater(const File& file) const;
  // True if `is_it` is, for a regular file of the directory (name, struct stat).
  template <typename IsIt>
  bool Any(const IsIt& is_it) const;
  // A file of the directory for which `is_it` is true and that has the position.
  template <typename IsIt>
  std::optional<File> Find(const LogPosition& position, const IsIt& is_it) const;

  void Watch();
  void WatchFile();
  void TakeEvents();
  // Opens what was renamed away from the path, if it is not being read already.
  void Enqueue(const std::string& name);
  // Reads up to the end of the file; true if the turn ended first.
  bool ReadFile(File& file, const OnLine& on_line, size_t& budget);
  void Lines(File& file, const OnLine& on_line);
  // The file was truncated: begins anew, or at its end if that was read before; what it had is read
  // from its copy, if there is one.
  void StartOver(File& file);
  // The file is a part of what was read of it; goes to its end.
  bool GoToRemainder(File& file);
  void RememberHead();
  // At the end of file_: goes over to what took its place. True if it did.
  bool Follow();
  void DropFormer();
  void Replace(File next);
  void SetFormer(File file);
  // Takes a file that was read before to where that ended.
  bool SeekRead(File& file) const;

  const std::string path_;
  const std::string directory_;
  const std::string name_;
  const LogTailLimits limits_;
  std::optional<LogPosition> from_;
  // Begin has been through.
  bool begun_ = false;
  absl::Status status_;
  LogTailCounters counters_;
  UniqueFd inotify_;
  int directory_watch_ = -1;
  int file_watch_ = -1;
  std::optional<File> file_;
  // Of file_.
  ChangeCounter changes_;
  // The first bytes of file_, as far as they were read, at most kFingerprintBytes.
  std::string head_;
  // By the events so far a file is at the path that has not been looked at.
  bool unseen_ = false;
  // Of the line being given, if it is of file_; else 0.
  size_t line_bytes_ = 0;
  std::deque<File> rotated_;
  std::optional<File> former_;
  int64_t former_until_ns_ = 0;
  // Where reading of former files ended.
  std::deque<LogPosition> finished_;
  int64_t now_ns_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_IDS_LOG_TAIL_H_
