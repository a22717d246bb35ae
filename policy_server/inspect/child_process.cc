#include "policy_server/inspect/child_process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "services/base/status_macros.h"
#include "services/runtime/unique_fd.h"

namespace rips::inspect {
namespace {

// Where the child reports why it cannot run the program; closed when it can.
constexpr int kReportFd = 3;
// Ours lie above what the child renumbers.
constexpr int kLowestFd = 10;
constexpr int kPollMsMax = 1000;
// Looked at this often when the kernel has no descriptor for a process.
constexpr int kPollMsWithoutPidfd = 5;
constexpr size_t kReadBytes = 16 << 10;
// So many reads empty a full pipe; whoever writes without end does not keep us longer.
constexpr int kErrorReadsMax = 8;

struct Pipe {
  UniqueFd read;
  UniqueFd write;
};

absl::Status NoDescriptor() {
  return absl::UnavailableError(absl::StrCat("no descriptor: ", std::strerror(errno)));
}

absl::StatusOr<UniqueFd> Raise(UniqueFd fd) {
  UniqueFd raised(fcntl(fd.get(), F_DUPFD_CLOEXEC, kLowestFd));
  if (raised.get() < 0) return NoDescriptor();
  return raised;
}

absl::StatusOr<Pipe> MakePipe() {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) return NoDescriptor();
  UniqueFd read(ends[0]);
  UniqueFd write(ends[1]);
  Pipe made;
  RIPS_ASSIGN_OR_RETURN(made.read, Raise(std::move(read)));
  RIPS_ASSIGN_OR_RETURN(made.write, Raise(std::move(write)));
  return made;
}

struct ChildPlan {
  const char* path;
  char* const* argv;
  char* const* envp;
  int input;
  int output;
  int errors;
  int report;
  pid_t parent;
  const ChildLimits* limits;
};

void CloseFrom(unsigned lowest) {
  if (syscall(SYS_close_range, lowest, ~0U, 0) == 0) return;
  rlimit open_files = {};
  getrlimit(RLIMIT_NOFILE, &open_files);
  const auto end = static_cast<unsigned>(std::min<rlim_t>(open_files.rlim_cur, 1 << 16));
  for (unsigned fd = lowest; fd < end; ++fd) close(static_cast<int>(fd));
}

void Limit(int what, uint64_t value) {
  const rlimit limit = {.rlim_cur = value, .rlim_max = value};
  setrlimit(static_cast<__rlimit_resource>(what), &limit);
}

// Runs in the child, which shares our memory until execve: system calls only, nothing is changed.
[[noreturn]] void RunChild(const ChildPlan& plan) {
  setsid();
  struct sigaction standard = {};
  standard.sa_handler = SIG_DFL;
  for (int number = 1; number < NSIG; ++number) sigaction(number, &standard, nullptr);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != plan.parent) _exit(127);
  prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0);
  umask(077);
  bool good = dup2(plan.input, 0) == 0 && dup2(plan.output, 1) == 1 && dup2(plan.errors, 2) == 2 &&
              dup3(plan.report, kReportFd, O_CLOEXEC) == kReportFd && chdir("/") == 0;
  if (good) {
    CloseFrom(kReportFd + 1);
    Limit(RLIMIT_CORE, 0);
    Limit(RLIMIT_FSIZE, 0);
    Limit(RLIMIT_NOFILE, plan.limits->open_files);
    if (plan.limits->address_space_bytes > 0) Limit(RLIMIT_AS, plan.limits->address_space_bytes);
    sigset_t none;
    sigemptyset(&none);
    sigprocmask(SIG_SETMASK, &none, nullptr);
    execve(plan.path, plan.argv, plan.envp);
  }
  const int error = errno;
  [[maybe_unused]] const ssize_t written = write(kReportFd, &error, sizeof(error));
  _exit(127);
}

// vfork rather than fork: it copies no page tables and runs no pthread_atfork handlers, of which
// gRPC has several. Rather than posix_spawn: that sets no resource limits.
pid_t Spawn(const ChildPlan& plan) {
  const pid_t pid = vfork();
  if (pid == 0) RunChild(plan);
  return pid;
}

// No handler of ours may run in the child while it shares our memory.
pid_t SpawnWithoutSignals(const ChildPlan& plan) {
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  const pid_t pid = Spawn(plan);
  const int error = errno;
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  errno = error;
  return pid;
}

pid_t SpawnProgram(const std::string& path, const ChildLimits& limits, int input, int output,
                   int errors, int report) {
  std::string name = path;
  std::string path_env = "PATH=/usr/bin:/bin";
  std::string lang_env = "LANG=C.UTF-8";
  char* argv[] = {name.data(), nullptr};
  char* envp[] = {path_env.data(), lang_env.data(), nullptr};
  return SpawnWithoutSignals({.path = path.c_str(),
                              .argv = argv,
                              .envp = envp,
                              .input = input,
                              .output = output,
                              .errors = errors,
                              .report = report,
                              .parent = getpid(),
                              .limits = &limits});
}

// Keeps SIGPIPE, which a write may raise, from this thread.
class [[nodiscard]] SigpipeBlock {
 public:
  SigpipeBlock() {
    sigemptyset(&pipe_);
    sigaddset(&pipe_, SIGPIPE);
    sigset_t pending;
    sigpending(&pending);
    was_pending_ = sigismember(&pending, SIGPIPE) == 1;
    pthread_sigmask(SIG_BLOCK, &pipe_, &before_);
  }
  ~SigpipeBlock() {
    const timespec now = {};
    while (!was_pending_ && sigtimedwait(&pipe_, nullptr, &now) < 0 && errno == EINTR) {
    }
    pthread_sigmask(SIG_SETMASK, &before_, nullptr);
  }
  SigpipeBlock(const SigpipeBlock&) = delete;
  SigpipeBlock& operator=(const SigpipeBlock&) = delete;

 private:
  sigset_t pipe_;
  sigset_t before_;
  bool was_pending_ = false;
};

}  // namespace

absl::StatusOr<std::unique_ptr<ChildProcess>> ChildProcess::Start(const std::string& path,
                                                                  const ChildLimits& limits) {
  RIPS_ASSIGN_OR_RETURN(Pipe input, MakePipe());
  RIPS_ASSIGN_OR_RETURN(Pipe output, MakePipe());
  RIPS_ASSIGN_OR_RETURN(Pipe errors, MakePipe());
  RIPS_ASSIGN_OR_RETURN(Pipe report, MakePipe());
  fcntl(input.write.get(), F_SETFL, O_NONBLOCK);
  fcntl(output.read.get(), F_SETFL, O_NONBLOCK);
  fcntl(errors.read.get(), F_SETFL, O_NONBLOCK);

  const pid_t pid = SpawnProgram(path, limits, input.read.get(), output.write.get(),
                                 errors.write.get(), report.write.get());
  if (pid < 0) {
    return absl::UnavailableError(absl::StrCat("cannot make a process: ", std::strerror(errno)));
  }
  auto child = std::unique_ptr<ChildProcess>(
      new ChildProcess(pid, input.write.Release(), output.read.Release(), errors.read.Release()));
  report.write = UniqueFd();
  int error = 0;
  ssize_t got;
  do {
    got = read(report.read.get(), &error, sizeof(error));
  } while (got < 0 && errno == EINTR);
  if (got > 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("cannot execute `", absl::CHexEscape(path), "`: ", std::strerror(error)));
  }
  return child;
}

ChildProcess::ChildProcess(pid_t pid, int input, int output, int errors)
    : pid_(pid),
      // Free of races: nobody else waits for children, so the process cannot have been reaped.
      pidfd_(static_cast<int>(syscall(SYS_pidfd_open, pid, 0))),
      input_(input),
      output_(output),
      errors_(errors) {}

ChildProcess::~ChildProcess() {
  if (!exit_) {
    kill(-pid_, SIGKILL);
    kill(pid_, SIGKILL);  // should it not have come to setsid()
    Reap();
  }
  for (const int fd : {pidfd_, input_, output_, errors_}) {
    if (fd >= 0) close(fd);
  }
}

void ChildProcess::Reap() {
  int status = 0;
  pid_t reaped;
  do {
    reaped = waitpid(pid_, &status, 0);
  } while (reaped < 0 && errno == EINTR);
  exit_ = Exit{.status = reaped == pid_ && WIFEXITED(status) ? WEXITSTATUS(status) : -1};
}

std::optional<ChildProcess::Exit> ChildProcess::Exited() {
  if (exit_) return exit_;
  siginfo_t info = {};
  // Looked at first and reaped after the group is killed: until then its number is not reused.
  if (waitid(P_PID, pid_, &info, WEXITED | WNOHANG | WNOWAIT) != 0 || info.si_pid == 0) {
    return std::nullopt;
  }
  kill(-pid_, SIGKILL);
  Reap();
  ReadErrors();
  return exit_;
}

void ChildProcess::ReadErrors() {
  char buffer[kReadBytes];
  for (int reads = 0; reads < kErrorReadsMax && errors_ >= 0; ++reads) {
    const ssize_t got = read(errors_, buffer, sizeof(buffer));
    if (got > 0) {
      const absl::string_view text(buffer, static_cast<size_t>(got));
      absl::StrAppend(&errors_begin_, text.substr(0, kErrorLineBytesMax - errors_begin_.size()));
      absl::StrAppend(&errors_end_, text);
      if (errors_end_.size() > kErrorLineBytesMax) {
        errors_end_.erase(0, errors_end_.size() - kErrorLineBytesMax);
      }
    } else if (got < 0 && errno == EAGAIN) {
      return;
    } else if (got == 0 || errno != EINTR) {
      close(errors_);
      errors_ = -1;
    }
  }
}

std::string ChildProcess::Errors() const {
  if (errors_begin_.empty()) return "";
  const std::vector<absl::string_view> begin =
      absl::StrSplit(errors_begin_, '\n', absl::SkipWhitespace());
  const std::vector<absl::string_view> end =
      absl::StrSplit(errors_end_, '\n', absl::SkipWhitespace());
  std::string shown(begin.empty() ? "(blank)" : absl::StripAsciiWhitespace(begin.front()));
  if (!end.empty() && (begin.empty() || end.back() != begin.front())) {
    absl::StrAppend(&shown, " ... ", absl::StripAsciiWhitespace(end.back()));
  }
  for (char& byte : shown) {
    if (!absl::ascii_isprint(static_cast<unsigned char>(byte))) byte = '?';
  }
  return shown;
}

ChildProcess::Io ChildProcess::Write(absl::string_view& rest) {
  if (input_ < 0) return Io::kClosed;
  const SigpipeBlock block;
  while (!rest.empty()) {
    const ssize_t wrote = write(input_, rest.data(), rest.size());
    if (wrote >= 0) {
      rest.remove_prefix(static_cast<size_t>(wrote));
    } else if (errno == EAGAIN) {
      return Io::kBlocked;
    } else if (errno != EINTR) {
      CloseInput();
      return Io::kClosed;
    }
  }
  return Io::kDone;
}

void ChildProcess::CloseInput() {
  if (input_ >= 0) close(input_);
  input_ = -1;
}

ChildProcess::Io ChildProcess::Read(std::string& text, size_t bytes_max) {
  if (output_ < 0) return Io::kClosed;
  char buffer[kReadBytes];
  while (text.size() < bytes_max) {
    const ssize_t got = read(output_, buffer, std::min(bytes_max - text.size(), sizeof(buffer)));
    if (got > 0) {
      text.append(buffer, static_cast<size_t>(got));
    } else if (got < 0 && errno == EAGAIN) {
      return Io::kBlocked;
    } else if (got == 0 || errno != EINTR) {
      close(output_);
      output_ = -1;  // else poll() would return at once for ever
      return Io::kClosed;
    }
  }
  return Io::kDone;
}

bool ChildProcess::Wait(bool to_write, int64_t deadline_ns, const Clock& clock) {
  const int64_t left_ns = deadline_ns - clock.Now().boottime_ns;
  if (left_ns <= 0) return false;
  // Negative descriptors are skipped by poll().
  pollfd fds[] = {{.fd = pidfd_, .events = POLLIN, .revents = 0},
                  {.fd = output_, .events = POLLIN, .revents = 0},
                  {.fd = errors_, .events = POLLIN, .revents = 0},
                  {.fd = to_write ? input_ : -1, .events = POLLOUT, .revents = 0}};
  const int64_t wait_ms = std::min<int64_t>(left_ns / kNanosPerMilli + 1,
                                            pidfd_ < 0 ? kPollMsWithoutPidfd : kPollMsMax);
  poll(fds, std::size(fds), static_cast<int>(wait_ms));
  ReadErrors();  // else a process that writes much would block
  return true;
}

}  // namespace rips::inspect
