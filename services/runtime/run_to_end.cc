#include "services/runtime/run_to_end.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "services/base/clock.h"
#include "services/base/status_macros.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/unique_fd.h"
#include "services/text/quote.h"

namespace rips {
namespace {

constexpr int kRunPollMsMax = 1000;
// Between two checks for the end when the kernel has no descriptor for a process.
constexpr int kRunPollMsWithoutPidfd = 5;

absl::Status NoDescriptorForRun() {
  return absl::UnavailableError(absl::StrCat("no descriptor: ", std::strerror(errno)));
}

// Above the three that the program gets.
absl::StatusOr<UniqueFd> AboveStandard(UniqueFd fd) {
  if (fd.get() > STDERR_FILENO) return fd;
  UniqueFd raised(fcntl(fd.get(), F_DUPFD_CLOEXEC, STDERR_FILENO + 1));
  if (raised.get() < 0) return NoDescriptorForRun();
  return raised;
}

// `text` in a file without a name, to be read from its start.
absl::StatusOr<UniqueFd> FileOf(absl::string_view text) {
  UniqueFd file(memfd_create("input", MFD_CLOEXEC));
  if (file.get() < 0) return NoDescriptorForRun();
  while (!text.empty()) {
    const ssize_t written = write(file.get(), text.data(), text.size());
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return absl::UnavailableError("cannot hold the input in memory");
    text.remove_prefix(static_cast<size_t>(written));
  }
  lseek(file.get(), 0, SEEK_SET);
  return AboveStandard(std::move(file));
}

struct OutputPipe {
  UniqueFd read_end;  // does not block
  UniqueFd write_end;
};

absl::StatusOr<OutputPipe> MakeOutputPipe() {
  int fds[2];
  if (pipe2(fds, O_CLOEXEC) != 0) return NoDescriptorForRun();
  OutputPipe made{UniqueFd(fds[0]), UniqueFd(fds[1])};
  fcntl(made.read_end.get(), F_SETFL, O_NONBLOCK);
  RIPS_ASSIGN_OR_RETURN(made.write_end, AboveStandard(std::move(made.write_end)));
  return made;
}

std::vector<char*> Pointers(std::vector<std::string>& words) {
  std::vector<char*> pointers;
  for (std::string& word : words) pointers.push_back(word.data());
  pointers.push_back(nullptr);
  return pointers;
}

// 0, or the error number.
int SpawnProgram(const ProgramCall& call, int in, int out, int err, pid_t* pid) {
  posix_spawn_file_actions_t files;
  posix_spawn_file_actions_init(&files);
  posix_spawn_file_actions_adddup2(&files, in, STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&files, out, STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&files, err, STDERR_FILENO);
  posix_spawn_file_actions_addclosefrom_np(&files, STDERR_FILENO + 1);
  posix_spawn_file_actions_addchdir_np(&files, "/");
  posix_spawnattr_t attr;
  posix_spawnattr_init(&attr);
  sigset_t all, none;
  sigfillset(&all);
  sigemptyset(&none);
  posix_spawnattr_setsigdefault(&attr, &all);
  posix_spawnattr_setsigmask(&attr, &none);
  posix_spawnattr_setflags(&attr,
                           POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSID);
  std::vector<std::string> words = call.words;
  std::vector<std::string> environment = call.environment;
  const int error = posix_spawn(pid, call.words[0].c_str(), &files, &attr, Pointers(words).data(),
                                Pointers(environment).data());
  posix_spawn_file_actions_destroy(&files);
  posix_spawnattr_destroy(&attr);
  return error;
}

bool IsReadable(int fd) {
  pollfd poll_fd = {.fd = fd, .events = POLLIN, .revents = 0};
  return poll(&poll_fd, 1, 0) > 0;
}

// One running program, until it is killed and reaped.
class Child {
 public:
  Child(pid_t pid, UniqueFd out, UniqueFd err)
      : pid_(pid),
        // Free of races: no other thread waits for it, so it cannot have been reaped.
        pidfd_(static_cast<int>(syscall(SYS_pidfd_open, pid, 0))),
        out_(std::move(out)),
        err_(std::move(err)) {}
  ~Child() { End(); }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  // Waits for output, its end, or `cancel_fd`, which it returns true for.
  bool Wait(int64_t left_ns, int cancel_fd) {
    // Negative descriptors are skipped by poll().
    pollfd fds[] = {{.fd = cancel_fd, .events = POLLIN, .revents = 0},
                    {.fd = pidfd_.get(), .events = POLLIN, .revents = 0},
                    {.fd = out_.get(), .events = POLLIN, .revents = 0},
                    {.fd = err_.get(), .events = POLLIN, .revents = 0}};
    const int most_ms = pidfd_.get() < 0 ? kRunPollMsWithoutPidfd : kRunPollMsMax;
    poll(fds, std::size(fds),
         static_cast<int>(std::min<int64_t>(left_ns / kNanosPerMilli + 1, most_ms)));
    return fds[0].revents != 0;
  }
  // It is not reaped yet: until it is, no other process has its number or its group's.
  bool Ended() const {
    siginfo_t info = {};
    return waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 &&
           info.si_pid != 0;
  }
  // What is there to read. False if that is more than `bytes_max` of one stream.
  bool Read(size_t bytes_max, ProgramEnd& into) {
    return Drain(out_, bytes_max, into.out) && Drain(err_, bytes_max, into.err);
  }
  // Kills the group and reaps the main process; its exit code.
  int End() {
    if (reaped_) return code_;
    kill(-pid_, SIGKILL);
    int status = 0;
    while (waitpid(pid_, &status, 0) < 0 && errno == EINTR) {
    }
    reaped_ = true;
    code_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    return code_;
  }

 private:
  static bool Drain(UniqueFd& fd, size_t bytes_max, std::string& text) {
    char buffer[16 << 10];
    while (fd.get() >= 0) {
      const ssize_t got = read(fd.get(), buffer, sizeof(buffer));
      if (got > 0) {
        text.append(buffer, static_cast<size_t>(got));
        if (text.size() > bytes_max) return false;
      } else if (got < 0 && errno == EAGAIN) {
        return true;
      } else if (got == 0 || errno != EINTR) {
        fd.Reset();
      }
    }
    return true;
  }

  const pid_t pid_;
  const UniqueFd pidfd_;
  UniqueFd out_;
  UniqueFd err_;
  bool reaped_ = false;
  int code_ = 0;
};

}  // namespace

absl::StatusOr<ProgramEnd> RunToEnd(const ProgramCall& call) {
  if (IsReadable(call.cancel_fd)) return absl::CancelledError("given up before it was started");
  RIPS_ASSIGN_OR_RETURN(UniqueFd in, FileOf(call.input));
  RIPS_ASSIGN_OR_RETURN(OutputPipe out, MakeOutputPipe());
  RIPS_ASSIGN_OR_RETURN(OutputPipe err, MakeOutputPipe());
  const std::string name = QuoteBytes(call.words[0]);
  pid_t pid = 0;
  const int error = SpawnProgram(call, in.get(), out.write_end.get(), err.write_end.get(), &pid);
  if (error != 0) {
    return absl::UnavailableError(absl::StrCat("cannot start ", name, ": ", std::strerror(error)));
  }
  in.Reset();
  out.write_end.Reset();
  err.write_end.Reset();
  Child child(pid, std::move(out.read_end), std::move(err.read_end));
  const int64_t deadline_ns = BoottimeAfter(call.timeout);
  ProgramEnd end;
  while (true) {
    // Before it is read: what it printed is there once it has ended.
    const bool ended = child.Ended();
    if (!child.Read(call.output_bytes_max, end)) {
      return absl::ResourceExhaustedError(
          absl::StrCat(name, " printed more than ", call.output_bytes_max, " bytes"));
    }
    if (ended) break;
    const int64_t left_ns = deadline_ns - BoottimeNow();
    if (left_ns <= 0) {
      return absl::DeadlineExceededError(
          absl::StrCat(name, " did not end within ", absl::FormatDuration(call.timeout)));
    }
    if (child.Wait(left_ns, call.cancel_fd)) return absl::CancelledError("given up");
  }
  end.exit_code = child.End();
  return end;
}

}  // namespace rips
