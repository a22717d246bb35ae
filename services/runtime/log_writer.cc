#include "services/runtime/log_writer.h"

#include <limits.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <memory>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/clock.h"
#include "spdlog/details/log_msg.h"
#include "spdlog/pattern_formatter.h"

namespace rips {
namespace {

// Whole lines in one write of at most this are not mixed with those of other processes on a pipe.
constexpr size_t kBatchBytes = PIPE_BUF;
// A longer line of others is cut.
constexpr size_t kOthersLineBytes = PIPE_BUF - 1;
// Others may write a line in pieces.
constexpr int kUnfinishedMs = 100;
constexpr int64_t kFlushPauseNs = 2 * kNanosPerMilli;

spdlog::level::level_enum ToSpdlog(LogLevel level) {
  switch (level) {
    case LogLevel::kDebug:
      return spdlog::level::debug;
    case LogLevel::kInfo:
      return spdlog::level::info;
    case LogLevel::kWarning:
      return spdlog::level::warn;
    case LogLevel::kError:
      return spdlog::level::err;
  }
  return spdlog::level::err;
}

int64_t MonotonicNs() {
  timespec now = {};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kNanosPerSecond + now.tv_nsec;
}

}  // namespace

std::string FormatLogLine(LogLevel level, absl::string_view message) {
  // One for each call: it keeps what it formatted last, which threads must not share.
  spdlog::pattern_formatter formatter("%Y-%m-%dT%H:%M:%S.%eZ %l %v", spdlog::pattern_time_type::utc,
                                      "\n");
  spdlog::memory_buf_t line;
  formatter.format(spdlog::details::log_msg("", ToSpdlog(level),
                                            spdlog::string_view_t(message.data(), message.size())),
                   line);
  return std::string(line.data(), line.size());
}

size_t WriteToLog(int fd, absl::string_view text) {
  size_t done = 0;
  while (done < text.size()) {
    const ssize_t written = write(fd, text.data() + done, text.size() - done);
    if (written >= 0) {
      done += static_cast<size_t>(written);
    } else if (errno == EAGAIN) {  // another process made the descriptor so
      pollfd waiting = {.fd = fd, .events = POLLOUT, .revents = 0};
      poll(&waiting, 1, -1);
    } else if (errno != EINTR) {
      break;
    }
  }
  return done;
}

bool TryWriteToLog(int fd, absl::string_view text) {
  text = text.substr(0, PIPE_BUF);
  pollfd ready = {.fd = fd, .events = POLLOUT, .revents = 0};
  if (poll(&ready, 1, 0) != 1 || (ready.revents & POLLOUT) == 0) return false;
  return write(fd, text.data(), text.size()) == static_cast<ssize_t>(text.size());
}

// --- LogQueue

std::deque<LogQueue::Line>* LogQueue::Oldest() {
  std::deque<Line>* oldest = nullptr;
  for (std::deque<Line>& each : levels_) {
    if (each.empty()) continue;
    if (oldest == nullptr || each.front().number < oldest->front().number) oldest = &each;
  }
  return oldest;
}

std::string LogQueue::Take(std::deque<Line>& lines) {
  std::string text = std::move(lines.front().text);
  lines.pop_front();
  --size_;
  bytes_ -= text.size();
  return text;
}

void LogQueue::Push(LogLevel level, std::string line) {
  ++size_;
  bytes_ += line.size();
  levels_[static_cast<size_t>(level)].push_back({next_number_++, std::move(line)});
  while (size_ > limits_.lines || bytes_ > limits_.bytes) {
    Take(*std::find_if(levels_.begin(), levels_.end(),
                       [](const std::deque<Line>& each) { return !each.empty(); }));
    ++dropped_;
  }
}

std::string LogQueue::Pop(size_t bytes_max) {
  std::string lines;
  while (std::deque<Line>* oldest = Oldest()) {
    if (!lines.empty() && lines.size() + oldest->front().text.size() > bytes_max) break;
    lines += Take(*oldest);
  }
  return lines;
}

// --- LogWriter

LogWriter::LogWriter(UniqueFd out, UniqueFd others, LogQueue::Limits limits)
    : out_(std::move(out)), others_(std::move(others)), queue_(limits) {}

LogWriter::~LogWriter() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
  }
  wake_.Wake();
  if (thread_.joinable()) thread_.join();
}

bool LogWriter::Start() {
  if (direct_ || thread_.joinable()) return !direct_;
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  bool started = true;
  try {
    thread_ = std::thread([this] { Run(); });
  } catch (const std::system_error&) {
    started = false;
  }
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  if (started) return true;
  std::string lines;
  {
    MutexLock lock(&mu_);
    direct_ = true;
    lines = queue_.Pop(PIPE_BUF);
    failed_ += queue_.size();
    waiting_ = 0;
  }
  TryWriteToLog(out_.get(), lines);
  return false;
}

void LogWriter::Push(LogLevel level, std::string line) {
  if (direct_) {
    if (TryWriteToLog(out_.get(), line)) return;
    MutexLock lock(&mu_);
    ++failed_;
    return;
  }
  {
    MutexLock lock(&mu_);
    const uint64_t dropped = queue_.dropped();
    ++waiting_;
    queue_.Push(level, std::move(line));
    waiting_ -= queue_.dropped() - dropped;
  }
  wake_.Wake();
}

uint64_t LogWriter::dropped() const {
  MutexLock lock(&mu_);
  return queue_.dropped() + failed_;
}

void LogWriter::AfterForkInChild() {
  direct_ = true;
  mu_.Unlock();
}

bool LogWriter::Idle() const {
  int unread = 0;
  if (others_.get() >= 0) ioctl(others_.get(), FIONREAD, &unread);
  // In this order: what is read from the pipe counts as waiting before `reading_` is over.
  return unread == 0 && !reading_ && waiting_ == 0;
}

bool LogWriter::Flush(absl::Duration longest, absl::Duration stall) const {
  if (direct_) return true;
  const int64_t end_ns = MonotonicNs() + absl::ToInt64Nanoseconds(longest);
  const int64_t stall_ns = absl::ToInt64Nanoseconds(stall);
  uint64_t writes = writes_;
  int64_t stalled_ns = MonotonicNs() + stall_ns;
  while (!Idle()) {
    const int64_t now_ns = MonotonicNs();
    if (writes_ != writes) {
      writes = writes_;
      stalled_ns = now_ns + stall_ns;
    }
    if (now_ns >= std::min(end_ns, stalled_ns)) return false;
    const timespec pause = {.tv_sec = 0, .tv_nsec = kFlushPauseNs};
    nanosleep(&pause, nullptr);
  }
  return true;
}

void LogWriter::Run() {
  pthread_setname_np(pthread_self(), "log");
  while (WriteSome()) {
  }
}

void LogWriter::Wait() {
  pollfd fds[] = {{wake_.get(), POLLIN, 0}, {others_.get(), POLLIN, 0}};
  waited_ = poll(fds, 2, unfinished_.empty() ? -1 : kUnfinishedMs) == 0;
  wake_.Drain();
}

void LogWriter::PushOthers(size_t length) {
  std::string line = unfinished_.substr(0, length);
  unfinished_.erase(0, length);
  if (line.back() != '\n') line += '\n';
  Push(LogLevel::kDebug, std::move(line));
}

void LogWriter::ReadOthers() {
  if (others_.get() < 0) return;
  reading_ = true;
  char piece[PIPE_BUF];
  if (const ssize_t got = read(others_.get(), piece, sizeof(piece)); got > 0) {
    waited_ = false;
    unfinished_.append(piece, static_cast<size_t>(got));
  }
  while (!unfinished_.empty()) {
    const size_t end = unfinished_.find('\n');
    if (end != std::string::npos) {
      PushOthers(std::min(end + 1, kOthersLineBytes));
    } else if (waited_ || unfinished_.size() >= kOthersLineBytes) {
      PushOthers(std::min(unfinished_.size(), kOthersLineBytes));
    } else {
      break;
    }
  }
  reading_ = !unfinished_.empty();
}

bool LogWriter::WriteSome() {
  ReadOthers();
  std::string lines;
  size_t count = 0;
  uint64_t dropped = 0;
  {
    MutexLock lock(&mu_);
    if (stopping_) return false;
    const size_t size = queue_.size();
    lines = queue_.Pop(kBatchBytes);
    count = size - queue_.size();
    dropped = queue_.dropped() + failed_;
    if (dropped > reported_ && !lines.empty()) {
      lines.insert(0, FormatLogLine(LogLevel::kWarning,
                                    FormatLogMessage("log lines dropped: the log was not read or "
                                                     "not writable for a while",
                                                     {{"lines", dropped - reported_}})));
    }
  }
  if (lines.empty()) {
    Wait();
    return true;
  }
  if (std::exchange(cut_, false)) lines.insert(0, "\n");
  const size_t written = WriteToLog(out_.get(), lines);
  {
    MutexLock lock(&mu_);
    if (written == lines.size()) {
      reported_ = dropped;
    } else {
      failed_ += std::min<uint64_t>(
          count, std::count(lines.begin() + static_cast<ptrdiff_t>(written), lines.end(), '\n'));
      cut_ = written > 0 && lines[written - 1] != '\n';
    }
    waiting_ -= count;
  }
  ++writes_;
  return true;
}

}  // namespace rips
