// Alerts as a file of JSON lines, for log shippers and people with `tail -f`. One line an alert:
//   {"id":"..","time":"2026-01-01T00:00:00.000000000Z","robot":"r1","rule":"..","severity":"high",
//    "text":"..","level":"ALERT","event":"..","decision_id":"3.17",
//    "subjects":[{"name":"/n","role":"sent the message","guid":"..","host":"..","pid":7,
//    "address":".."}]}
// A decision id of "0.0" = before any decision; of subjects all but name and role may be "" or 0.
// Output is ASCII: everything else, control characters included, is \u-escaped, so that text from a
// robot cannot act on a terminal; bytes that are not UTF-8 become U+FFFD.
//
// The store is the record; this is a copy without holes, written after the alert is durable:
// whoever appends asks where the file ends (LastId) and goes on from there (AlertFeed). What a
// crash or a full disk left of a line is cut off, and its alert is written again.
//
// With `rotate_bytes` the log rotates the file itself: before a line that would make it longer, the
// file becomes FILE.1, as RotateFile describes, and a new one begins. A line is whole in one file;
// one that is longer than `rotate_bytes` has a file of its own. A rotation that fails leaves the
// file in use, which then grows; each append tries again. Without `rotate_bytes` the file grows
// until logrotate or an operator moves it.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_ALERT_LOG_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_ALERT_LOG_H_

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/server/store/file_rotation.h"
#include "policy_server/server/store/store.h"
#include "services/runtime/mutex.h"

namespace rips::store {

// One alert as above, without the line break.
std::string FormatAlertLine(const AlertRecord& alert);

struct AlertLogOptions {
  // The file is rotated before it becomes longer; 0: never.
  uint64_t rotate_bytes = 0;
  // Rotated files that are kept: FILE.1 to FILE.`keep`. At least 1.
  int keep = 1;
  // Called at each attempt to rotate that fails, on the thread that appends. May be null.
  std::function<void()> on_rotation_failure;
  // For tests; null = rename(2).
  RenameFile rename_file;
};

// Any thread.
class AlertLog {
 public:
  // Appends to `path`, made (mode 0640) if missing; its directory must exist. Unavailable if it
  // cannot be opened, or if it is a symbolic link and is to be rotated.
  static absl::StatusOr<std::unique_ptr<AlertLog>> Open(const std::string& path,
                                                        AlertLogOptions options = {});
  ~AlertLog();
  AlertLog(const AlertLog&) = delete;
  AlertLog& operator=(const AlertLog&) = delete;

  // Writes one line an alert, to a new file if the old one was moved or removed. How many it wrote,
  // the first ones: fewer than all if a later one goes into another file that cannot be written.
  // Unavailable or ResourceExhausted (disk full): none of them is there, or, where what was written
  // cannot be cut off again, the first of them and a piece of one, after which the next call starts
  // on a line of its own. A later call may succeed.
  absl::StatusOr<size_t> Append(std::span<const AlertRecord> alerts) ABSL_LOCKS_EXCLUDED(mutex_);

  // Opens the path anew, as after a rotation. On failure the old file stays in use.
  absl::Status Reopen() ABSL_LOCKS_EXCLUDED(mutex_);

  // The id of the alert on the last line, with rotation of FILE.1 if the file is empty; empty if
  // there is no line, or none of an alert.
  absl::StatusOr<std::string> LastId() ABSL_LOCKS_EXCLUDED(mutex_);

 private:
  AlertLog(std::string path, AlertLogOptions options);

  absl::Status OpenLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool MovedLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // FILE.1, if it is a regular file; else -1.
  int OpenRotatedLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Rotates if the file has lines and `line_bytes` more are too many.
  absl::Status RotateIfFullLocked(size_t line_bytes) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // All of `text`, which ends with a line break, or an error as of Append.
  absl::Status WriteLocked(std::string text) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Back to `size`; else the next line begins anew.
  void CutLocked(off_t size) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const std::string path_;
  const AlertLogOptions options_;
  Mutex mutex_;
  int fd_ ABSL_GUARDED_BY(mutex_) = -1;
  // The file ends in the middle of a line.
  bool torn_ ABSL_GUARDED_BY(mutex_) = false;
  // The last attempt to rotate failed, which was logged.
  bool rotation_failing_ ABSL_GUARDED_BY(mutex_) = false;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_ALERT_LOG_H_
