#include "policy_server/policy/inspect/child_process.h"

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
#include <filesystem>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "services/base/status_macros.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/unique_fd.h"

namespace rips::inspect {
namespace {

// From the start until the program runs, or the rules are loaded.
constexpr absl::Duration kStartMax = absl::Seconds(10);
// For rips-inspect to find and kill what its program started, without a PID namespace.
constexpr absl::Duration kSweepMax = absl::Seconds(2);
constexpr size_t kReportBytesMax = 16 << 10;
// Ours lie above what the child renumbers.
constexpr int kLowestFd = 10;
constexpr int kPollMsMax = 1000;
// Looked at this often when the kernel has no descriptor for a process.
constexpr int kPollMsWithoutPidfd = 5;
constexpr size_t kReadBytes = 16 << 10;
constexpr int kInputPipeBytes = 1 << 20;
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
  int cgroup;
  const std::vector<int>* more;  // from kRulesFd on
  pid_t parent;
};

void CloseFrom(unsigned lowest) {
  if (syscall(SYS_close_range, lowest, ~0U, 0) == 0) return;
  rlimit open_files = {};
  getrlimit(RLIMIT_NOFILE, &open_files);
  const auto end = static_cast<unsigned>(std::min<rlim_t>(open_files.rlim_cur, 1 << 16));
  for (unsigned fd = lowest; fd < end; ++fd) close(static_cast<int>(fd));
}

// Runs in the child, which shares our memory until execve: system calls only, nothing is changed.
[[noreturn]] void RunChild(const ChildPlan& plan) {
  setsid();
  struct sigaction standard = {};
  standard.sa_handler = SIG_DFL;
  for (int number = 1; number < NSIG; ++number) sigaction(number, &standard, nullptr);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != plan.parent) _exit(127);
  umask(077);
  bool good = dup2(plan.input, 0) == 0 && dup2(plan.output, 1) == 1 && dup2(plan.errors, 2) == 2 &&
              dup2(plan.report, kReportFd) == kReportFd &&
              dup2(plan.cgroup, kCgroupFd) == kCgroupFd && chdir("/") == 0;
  int next = kRulesFd;
  for (const int fd : *plan.more) good = good && dup2(fd, next++) >= 0;
  if (good) {
    CloseFrom(static_cast<unsigned>(next));
    sigset_t none;
    sigemptyset(&none);
    sigprocmask(SIG_SETMASK, &none, nullptr);
    execve(plan.path, plan.argv, plan.envp);
  }
  const int error = errno;
  char report[1 + sizeof(error)] = {kReportExec};
  std::memcpy(report + 1, &error, sizeof(error));
  [[maybe_unused]] const ssize_t written =
      write(good ? kReportFd : plan.report, report, sizeof(report));
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

// The first of `words` is the file that is executed.
pid_t SpawnWords(std::vector<std::string> words, ChildPlan plan) {
  std::string path_env = "PATH=/usr/bin:/bin";
  std::string lang_env = "LANG=C.UTF-8";
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  char* envp[] = {path_env.data(), lang_env.data(), nullptr};
  plan.path = words[0].c_str();
  plan.argv = argv.data();
  plan.envp = envp;
  plan.parent = getpid();
  return SpawnWithoutSignals(plan);
}

absl::StatusOr<std::string> FindHelper(const std::string& name, const Containment& containment) {
  if (!containment.helpers.empty()) return absl::StrCat(containment.helpers, "/", name);
  std::error_code error;
  const std::filesystem::path own = std::filesystem::read_symlink("/proc/self/exe", error);
  if (!error) return (own.parent_path() / name).string();
  return absl::UnavailableError(absl::StrCat("cannot read /proc/self/exe to find ", name));
}

std::vector<std::string> HelperWords(const std::string& helper, const std::string& mode,
                                     const ChildLimits& limits, const Containment& containment) {
  const auto& ids = containment.ids;
  return {helper,
          mode,
          ids ? absl::StrCat(ids->uid) : "-",
          ids ? absl::StrCat(ids->gid) : "-",
          absl::StrCat(limits.address_space_bytes),
          absl::StrCat(limits.open_files),
          absl::StrCat(limits.tasks)};
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

struct ChildProcess::Command {
  std::string helper;
  std::string mode;
  std::vector<std::string> words;  // after the limits
  std::vector<int> descriptors;    // from kRulesFd on
};

absl::StatusOr<std::unique_ptr<ChildProcess>> ChildProcess::StartPlugin(
    const std::string& program, const std::string& root, const ChildLimits& limits,
    const Containment& containment) {
  Command command{.helper = "rips-inspect", .mode = "plugin", .words = containment.readable};
  for (const std::string& word : {root, std::string("--"), program}) command.words.push_back(word);
  return Start(command, limits, containment);
}

absl::StatusOr<std::unique_ptr<ChildProcess>> ChildProcess::StartScanner(
    int rules_fd, int payload_fd, const ChildLimits& limits, const Containment& containment) {
  return Start({.helper = "rips-scan",
                .mode = "yara",
                .words = {"--"},
                .descriptors = {rules_fd, payload_fd}},
               limits, containment);
}

absl::StatusOr<std::vector<std::string>> ProbeContainment(const Containment& containment) {
  RIPS_ASSIGN_OR_RETURN(
      const auto process,
      ChildProcess::Start({.helper = "rips-inspect", .mode = "probe", .words = {"--"}},
                          ChildLimits{}, containment));
  std::vector<std::string> missing = process->missing();
  if (containment.cgroups == nullptr) {
    missing.emplace_back("no cgroup: what a plugin started is killed without one");
  }
  return missing;
}

absl::StatusOr<std::unique_ptr<ChildProcess>> ChildProcess::Start(const Command& command,
                                                                  const ChildLimits& limits,
                                                                  const Containment& containment) {
  RIPS_ASSIGN_OR_RETURN(const std::string helper, FindHelper(command.helper, containment));
  std::vector<std::string> words = HelperWords(helper, command.mode, limits, containment);
  words.insert(words.end(), command.words.begin(), command.words.end());
  RIPS_ASSIGN_OR_RETURN(Pipe input, MakePipe());
  RIPS_ASSIGN_OR_RETURN(Pipe output, MakePipe());
  RIPS_ASSIGN_OR_RETURN(Pipe errors, MakePipe());
  RIPS_ASSIGN_OR_RETURN(Pipe report, MakePipe());
  for (const int fd : {input.write.get(), output.read.get(), errors.read.get()}) {
    fcntl(fd, F_SETFL, O_NONBLOCK);
  }
  // A payload in one write, if the kernel lets us.
  fcntl(input.write.get(), F_SETPIPE_SZ, kInputPipeBytes);
  std::unique_ptr<RunCgroup> cgroup;
  UniqueFd procs(open("/dev/null", O_WRONLY | O_CLOEXEC));
  if (containment.cgroups != nullptr) {
    RIPS_ASSIGN_OR_RETURN(cgroup, containment.cgroups->Make());
    RIPS_ASSIGN_OR_RETURN(procs, cgroup->OpenProcs());
    cgroup->Limit(limits.tasks, limits.memory_bytes);
  }
  RIPS_ASSIGN_OR_RETURN(procs, Raise(std::move(procs)));
  std::vector<UniqueFd> raised;
  std::vector<int> more;
  for (const int fd : command.descriptors) {
    raised.emplace_back(fcntl(fd, F_DUPFD_CLOEXEC, kLowestFd));
    if (raised.back().get() < 0) return NoDescriptor();
    more.push_back(raised.back().get());
  }

  const pid_t pid = SpawnWords(std::move(words), {.input = input.read.get(),
                                                  .output = output.write.get(),
                                                  .errors = errors.write.get(),
                                                  .report = report.write.get(),
                                                  .cgroup = procs.get(),
                                                  .more = &more});
  if (pid < 0) {
    return absl::UnavailableError(absl::StrCat("cannot make a process: ", std::strerror(errno)));
  }
  auto child = std::unique_ptr<ChildProcess>(new ChildProcess(
      pid, input.write.Release(), output.read.Release(), errors.read.Release(), std::move(cgroup)));
  report.write = UniqueFd();
  RIPS_RETURN_IF_ERROR(child->ReadReport(report.read.get(), helper));
  return child;
}

absl::Status ChildProcess::ReadReport(int fd, const std::string& helper) {
  const int64_t until_ns = BoottimeAfter(kStartMax);
  std::string report;
  while (report.size() < kReportBytesMax) {
    const int64_t left_ns = until_ns - BoottimeNow();
    if (left_ns <= 0) return absl::InvalidArgumentError(absl::StrCat(helper, " does not come up"));
    pollfd poll_fd = {.fd = fd, .events = POLLIN, .revents = 0};
    if (poll(&poll_fd, 1, static_cast<int>(left_ns / kNanosPerMilli + 1)) <= 0) continue;
    char buffer[512];
    const ssize_t got = read(fd, buffer, sizeof(buffer));
    if (got == 0) break;
    if (got > 0) report.append(buffer, static_cast<size_t>(got));
  }
  for (absl::string_view line : absl::StrSplit(report, '\n', absl::SkipEmpty())) {
    const char kind = line.front();
    line.remove_prefix(1);
    if (kind == kReportMissing) missing_.emplace_back(line);
    if (kind == kReportSweeps) sweeps_ = true;
    if (kind == kReportFailed) return absl::InvalidArgumentError(line);
    if (kind == kReportExec) {
      int error = 0;
      std::memcpy(&error, report.data() + 1, std::min(sizeof(error), report.size() - 1));
      return absl::InvalidArgumentError(
          absl::StrCat("cannot execute `", absl::CHexEscape(helper), "`: ", std::strerror(error)));
    }
  }
  return absl::OkStatus();
}

ChildProcess::ChildProcess(pid_t pid, int input, int output, int errors,
                           std::unique_ptr<RunCgroup> cgroup)
    : pid_(pid),
      cgroup_(std::move(cgroup)),
      // Free of races: nobody else waits for children, so the process cannot have been reaped.
      pidfd_(static_cast<int>(syscall(SYS_pidfd_open, pid, 0))),
      input_(input),
      output_(output),
      errors_(errors) {}

ChildProcess::~ChildProcess() {
  if (!exit_) {
    KillAll();
    Reap();
  }
  for (const int fd : {pidfd_, input_, output_, errors_}) {
    if (fd >= 0) close(fd);
  }
  if (cgroup_ == nullptr) return;
  // Killed already; the cgroup can be removed when nothing is left.
  const int64_t until_ns = BoottimeAfter(kGoneWait);
  while (cgroup_->Populated() && BoottimeNow() < until_ns) poll(nullptr, 0, 1);
}

void ChildProcess::KillAll() {
  if (cgroup_ != nullptr) {
    cgroup_->Kill();
  } else if (sweeps_) {
    kill(pid_, SIGTERM);
    pollfd ended = {.fd = pidfd_, .events = POLLIN, .revents = 0};
    poll(&ended, 1, static_cast<int>(absl::ToInt64Milliseconds(kSweepMax)));
  }
  kill(-pid_, SIGKILL);
  kill(pid_, SIGKILL);  // should it not have come to setsid()
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
  if (cgroup_ != nullptr) cgroup_->Kill();
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

std::string ChildProcess::Errors() {
  ReadErrors();
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
