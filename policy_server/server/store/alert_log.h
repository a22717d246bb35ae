// Alerts as a file of JSON lines, for log shippers and people with `tail -f`. One line an alert:
//   {"id":"..","time":"2026-01-01T00:00:00.000000000Z","robot":"r1","rule":"..","severity":"high",
//    "text":"..","level":"ALERT","event":"..","decision_id":"3.17",
//    "subjects":[{"name":"/n","role":"sent the message","guid":"..","host":"..","pid":7}]}
// A decision id of "0.0" = before any decision; of subjects guid, host and pid may be "" and 0.
// Output is ASCII: everything else, control characters included, is \u-escaped, so that text from a
// robot cannot act on a terminal; bytes that are not UTF-8 become U+FFFD.
//
// The store is the record; this is a copy without holes, written after the alert is durable:
// whoever appends asks where the file ends (LastId) and goes on from there (AlertFeed). What a
// crash or a full disk left of a line is cut off, and its alert is written again.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_ALERT_LOG_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_ALERT_LOG_H_

#include <sys/types.h>

#include <memory>
#include <span>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/server/store/store.h"
#include "services/runtime/mutex.h"

namespace rips::store {

// One alert as above, without the line break.
std::string FormatAlertLine(const AlertRecord& alert);

// Any thread.
class AlertLog {
 public:
  // Appends to `path`, made (mode 0640) if missing; its directory must exist. Unavailable if it
  // cannot be opened.
  static absl::StatusOr<std::unique_ptr<AlertLog>> Open(const std::string& path);
  ~AlertLog();
  AlertLog(const AlertLog&) = delete;
  AlertLog& operator=(const AlertLog&) = delete;

  // Writes one line an alert, to a new file if the old one was moved or removed. Unavailable or
  // ResourceExhausted (disk full): none of them is there, or, where what was written cannot be cut
  // off again, the first of them and a piece of one, after which the next call starts on a line of
  // its own. A later call may succeed.
  absl::Status Append(std::span<const AlertRecord> alerts) ABSL_LOCKS_EXCLUDED(mutex_);

  // Opens the path anew, as after a rotation. On failure the old file stays in use.
  absl::Status Reopen() ABSL_LOCKS_EXCLUDED(mutex_);

  // The id of the alert on the last line; empty if the file has no line, or none of an alert.
  absl::StatusOr<std::string> LastId() ABSL_LOCKS_EXCLUDED(mutex_);

 private:
  explicit AlertLog(std::string path) : path_(std::move(path)) {}

  absl::Status OpenLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  bool MovedLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);
  // Back to `size`; else the next line begins anew.
  void CutLocked(off_t size) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mutex_);

  const std::string path_;
  Mutex mutex_;
  int fd_ ABSL_GUARDED_BY(mutex_) = -1;
  // The file ends in the middle of a line.
  bool torn_ ABSL_GUARDED_BY(mutex_) = false;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_ALERT_LOG_H_
