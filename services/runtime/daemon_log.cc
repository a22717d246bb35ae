#include "services/runtime/daemon_log.h"

#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <optional>
#include <system_error>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "services/runtime/log_limiter.h"
#include "services/runtime/log_writer.h"
#include "services/runtime/unique_fd.h"

// Of the sanitizers, if the program has one: its report must not go through a pipe that nothing
// reads once the process has ended.
extern "C" __attribute__((weak)) void __sanitizer_set_report_fd(void* fd);

namespace rips {
namespace {

constexpr absl::Duration kExitLongest = absl::Seconds(1);
constexpr absl::Duration kExitStall = absl::Milliseconds(250);
constexpr absl::Duration kAbortLongest = absl::Milliseconds(300);
constexpr double kLibraryBurst = 20;
constexpr double kLibraryPerSecond = 2;

// Never destroyed: threads log until the process has ended.
std::atomic<LogWriter*> g_writer = nullptr;

void FlushAtExit() {
  LogWriter* writer = g_writer;
  writer->Start();
  writer->Flush(kExitLongest, kExitStall);
}

// Of abort(), and of a watchdog that sends SIGABRT.
void OnAbort(int signal) {
  g_writer.load()->Flush(kAbortLongest, kAbortLongest);
  ::signal(signal, SIG_DFL);
  raise(signal);
}

// Of std::terminate.
[[noreturn]] void OnTerminate() {
  try {
    if (const std::exception_ptr thrown = std::current_exception()) std::rethrow_exception(thrown);
    LogError("ended by std::terminate");
  } catch (const std::system_error& error) {
    if (error.code() == std::errc::resource_unavailable_try_again) {
      LogError(
          "cannot start a thread: a limit of processes and threads is reached "
          "(RLIMIT_NPROC, TasksMax= of the unit); raise it");
    } else {
      LogError("ended by an error", {{"error", error.what()}});
    }
  } catch (const std::exception& error) {
    LogError("ended by an error", {{"error", error.what()}});
  } catch (...) {
    LogError("ended by an exception");
  }
  std::abort();
}

void BeforeFork() { g_writer.load()->BeforeFork(); }
void AfterForkInParent() { g_writer.load()->AfterForkInParent(); }
void AfterForkInChild() { g_writer.load()->AfterForkInChild(); }

}  // namespace

void OpenStandardStreams() {
  for (int fd = STDIN_FILENO; fd <= STDERR_FILENO; ++fd) {
    struct stat info = {};
    // An inode without a type is anonymous: an eventfd that gRPC opens before main(), to see
    // whether there are any, and neither uses nor closes.
    if (fstat(fd, &info) == 0 && (info.st_mode & S_IFMT) != 0) continue;
    // The directory takes the number where there is no such device.
    UniqueFd null(open("/dev/null", fd == STDOUT_FILENO ? O_RDONLY : O_RDWR));
    if (null.get() < 0) null = UniqueFd(open("/", O_RDONLY | O_DIRECTORY));
    if (null.get() == fd) {
      null.Release();
    } else if (dup2(null.get(), fd) != fd) {
      _exit(EXIT_FAILURE);
    }
  }
}

void QueueLog() {
  if (g_writer != nullptr) return;
  UniqueFd out(fcntl(STDERR_FILENO, F_DUPFD_CLOEXEC, STDERR_FILENO + 1));
  int ends[2] = {-1, -1};
  if (out.get() < 0 || pipe2(ends, O_CLOEXEC | O_NONBLOCK) != 0) {
    LogError("cannot queue the log; a reader of it that stops will stop this process",
             {{"error", std::strerror(errno)}});
    return;
  }
  UniqueFd others(ends[0]);
  const UniqueFd written_by_others(ends[1]);
  if (__sanitizer_set_report_fd != nullptr) {
    __sanitizer_set_report_fd(reinterpret_cast<void*>(static_cast<intptr_t>(out.get())));
  }
  g_writer = new LogWriter(std::move(out), std::move(others));
  dup2(written_by_others.get(), STDERR_FILENO);
  pthread_atfork(BeforeFork, AfterForkInParent, AfterForkInChild);
  std::atexit(FlushAtExit);
  struct sigaction action = {};
  action.sa_handler = OnAbort;
  action.sa_flags = static_cast<int>(SA_RESETHAND);
  sigaction(SIGABRT, &action, nullptr);
  std::set_terminate(OnTerminate);
}

void StartLogThread() {
  LogWriter* writer = g_writer;
  if (writer == nullptr || writer->Start()) return;
  LogError(
      "no thread for the log: it is written only while its reader reads; raise the limit of "
      "processes (RLIMIT_NPROC, TasksMax=)");
}

void StartLogWriter() {
  QueueLog();
  StartLogThread();
}

uint64_t LogLinesDropped() {
  const LogWriter* writer = g_writer;
  return writer == nullptr ? 0 : writer->dropped();
}

void WriteLogLine(LogLevel level, std::string line) {
  if (LogWriter* writer = g_writer) {
    writer->Push(level, std::move(line));
  } else {
    WriteToLog(STDERR_FILENO, line);
  }
}

void LogOfLibrary(LogLevel level, absl::string_view library, absl::string_view text,
                  absl::string_view place) {
  if (!LogEnabled(level)) return;
  static LogLimiter& limiter = *new LogLimiter(kLibraryBurst, kLibraryPerSecond);
  const std::optional<uint64_t> left_out = limiter.Admit(std::string(library));
  if (!left_out.has_value()) return;
  std::string whole(absl::StripAsciiWhitespace(text));
  if (!place.empty()) absl::StrAppend(&whole, " (", place, ")");
  if (*left_out > 0) {
    Log(level, library, {{"text", whole}, {"left_out", *left_out}});
  } else {
    Log(level, library, {{"text", whole}});
  }
}

}  // namespace rips
