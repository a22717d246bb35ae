// The thread that writes the log, so that no other thread waits for what reads it: a pipe whose
// reader has stopped, a terminal after Ctrl-S, a file on a disk that hangs.
#ifndef RIPS_SERVICES_RUNTIME_LOG_WRITER_H_
#define RIPS_SERVICES_RUNTIME_LOG_WRITER_H_

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/runtime/log.h"
#include "services/runtime/mutex.h"
#include "services/runtime/unique_fd.h"
#include "services/runtime/wake_fd.h"

namespace rips {

// `2026-11-21T13:00:00.000Z info MESSAGE` and a line break. Any thread.
std::string FormatLogLine(LogLevel level, absl::string_view message);

// Writes all of `text` and waits for its reader. Returns how many bytes were written before an
// error: text.size() if there was none.
size_t WriteToLog(int fd, absl::string_view text);

// Writes `text`, cut to PIPE_BUF, if that does not wait. False if it would, or failed.
bool TryWriteToLog(int fd, absl::string_view text);

// Lines that wait to be written. One thread at a time.
class LogQueue {
 public:
  struct Limits {
    size_t lines = 4'096;
    size_t bytes = 1 << 20;
  };
  explicit LogQueue(Limits limits) : limits_(limits) {}

  // Takes in a line with its line break. While the queue exceeds a limit, it drops the oldest line
  // of the lowest level, which may be this one.
  void Push(LogLevel level, std::string line);
  // The oldest lines, as many as fit `bytes_max` bytes, at least one; empty if there is none.
  std::string Pop(size_t bytes_max);

  size_t size() const { return size_; }
  uint64_t dropped() const { return dropped_; }

 private:
  struct Line {
    uint64_t number = 0;  // in the order of Push
    std::string text;
  };
  // The level with the oldest line; null if there is no line.
  std::deque<Line>* Oldest();
  std::string Take(std::deque<Line>& lines);

  const Limits limits_;
  std::array<std::deque<Line>, 4> levels_;  // by LogLevel
  uint64_t next_number_ = 0;
  size_t size_ = 0;
  size_t bytes_ = 0;
  uint64_t dropped_ = 0;
};

// Any thread, unless a method says otherwise. Only the destructor waits for the log's reader.
class LogWriter {
 public:
  // Writes to `out`. With `others`, the reading end of a pipe, a line that comes out of it is
  // written as it is, and dropped like a debug line; both ends of that pipe do not block.
  explicit LogWriter(UniqueFd out, UniqueFd others = UniqueFd(), LogQueue::Limits limits = {});
  // For tests: joins the thread, which may wait for the log's reader.
  ~LogWriter();
  LogWriter(const LogWriter&) = delete;
  LogWriter& operator=(const LogWriter&) = delete;

  // Starts the thread, with all signals blocked, unless it runs; lines wait until then. If the
  // system has no thread: false, and from now on a line is written only if that does not wait. One
  // thread at a time.
  bool Start() ABSL_LOCKS_EXCLUDED(mu_);
  // `line` with its line break.
  void Push(LogLevel level, std::string line) ABSL_LOCKS_EXCLUDED(mu_);
  // Waits until all is written, at most `longest`, and no longer than `stall` while nothing is
  // written. True if all is. Can be called in a signal handler.
  bool Flush(absl::Duration longest, absl::Duration stall) const;
  // Lines that were not written, since construction.
  uint64_t dropped() const ABSL_LOCKS_EXCLUDED(mu_);
  // Where it writes.
  int out() const { return out_.get(); }

  // Around fork(): the child has no thread, and must not find the lock taken. There a line is
  // written only if that does not wait.
  void BeforeFork() ABSL_NO_THREAD_SAFETY_ANALYSIS { mu_.Lock(); }
  void AfterForkInParent() ABSL_NO_THREAD_SAFETY_ANALYSIS { mu_.Unlock(); }
  void AfterForkInChild() ABSL_NO_THREAD_SAFETY_ANALYSIS;

 private:
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  void Wait();
  // What others wrote to their pipe, as lines.
  void ReadOthers() ABSL_LOCKS_EXCLUDED(mu_);
  void PushOthers(size_t length) ABSL_LOCKS_EXCLUDED(mu_);
  // False: stop.
  bool WriteSome() ABSL_LOCKS_EXCLUDED(mu_);
  bool Idle() const;

  const UniqueFd out_;
  const UniqueFd others_;
  const WakeFd wake_;
  std::atomic<bool> direct_ = false;  // there is no thread, and will be none
  std::atomic<bool> reading_ = false;
  std::atomic<size_t> waiting_ = 0;  // lines in the queue and on their way
  std::atomic<uint64_t> writes_ = 0;

  mutable Mutex mu_;
  LogQueue queue_ ABSL_GUARDED_BY(mu_);
  uint64_t failed_ ABSL_GUARDED_BY(mu_) = 0;    // lines that the system did not take
  uint64_t reported_ ABSL_GUARDED_BY(mu_) = 0;  // of the dropped ones
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;

  std::string unfinished_;  // of others; the thread's alone
  bool waited_ = false;     // in vain for the end of unfinished_
  bool cut_ = false;        // the last line was written in part
  std::thread thread_;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_LOG_WRITER_H_
