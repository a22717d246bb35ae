#include "mode_actuator/exec/posix_runner.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/eventfd.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "services/base/status_macros.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {
namespace {

constexpr int kPollMsMax = 1000;
// Read from one program before the others get a turn.
constexpr size_t kReadBytesPerTurn = 1 << 20;

std::string Quote(absl::string_view text) {
  return absl::StrCat("`", absl::CHexEscape(text.substr(0, 256)), "`");
}

absl::Status Unsafe(absl::string_view path, absl::string_view why) {
  return absl::PermissionDeniedError(absl::StrCat(Quote(path), " ", why));
}

absl::Status CheckComponent(const struct stat& info, absl::string_view path, bool last) {
  if (S_ISLNK(info.st_mode)) return Unsafe(path, "is a symbolic link; name its target");
  if (info.st_uid != 0) return Unsafe(path, "is not owned by root");
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) != 0) {
    return Unsafe(path, "can be written by others; chmod go-w");
  }
  if (!last) return S_ISDIR(info.st_mode) ? absl::OkStatus() : Unsafe(path, "is no directory");
  if (!S_ISREG(info.st_mode)) return Unsafe(path, "is no regular file");
  if ((info.st_mode & S_IXUSR) == 0) return Unsafe(path, "is not executable");
  return absl::OkStatus();
}

// The attributes and descriptors every program starts with.
class SpawnSetup {
 public:
  explicit SpawnSetup(int output_fd) {
    posix_spawn_file_actions_init(&files_);
    posix_spawn_file_actions_addopen(&files_, 0, "/dev/null", O_RDONLY, 0);
    posix_spawn_file_actions_adddup2(&files_, output_fd, 1);
    posix_spawn_file_actions_adddup2(&files_, output_fd, 2);
    posix_spawn_file_actions_addclosefrom_np(&files_, 3);
    posix_spawn_file_actions_addchdir_np(&files_, "/");
    posix_spawnattr_init(&attr_);
    sigset_t all, none;
    sigfillset(&all);
    sigemptyset(&none);
    posix_spawnattr_setsigdefault(&attr_, &all);
    posix_spawnattr_setsigmask(&attr_, &none);
    posix_spawnattr_setflags(&attr_,
                             POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSID);
  }
  ~SpawnSetup() {
    posix_spawn_file_actions_destroy(&files_);
    posix_spawnattr_destroy(&attr_);
  }
  SpawnSetup(const SpawnSetup&) = delete;
  SpawnSetup& operator=(const SpawnSetup&) = delete;

  // 0, or the error number.
  int Spawn(const std::string& path, const std::vector<std::string>& args, bool drill, pid_t* pid) {
    std::vector<std::string> words = {path};
    words.insert(words.end(), args.begin(), args.end());
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    std::string path_env = "PATH=/usr/sbin:/usr/bin";
    std::string lang_env = "LANG=C.UTF-8";
    std::string drill_env = "RIPS_DRILL=1";
    char* envp[] = {path_env.data(), lang_env.data(), drill ? drill_env.data() : nullptr, nullptr};
    return posix_spawn(pid, path.c_str(), &files_, &attr_, argv.data(), envp);
  }

 private:
  posix_spawn_file_actions_t files_;
  posix_spawnattr_t attr_;
};

}  // namespace

absl::Status CheckProgramPath(int root_fd, absl::string_view path) {
  if (path.empty() || path.front() != '/') return Unsafe(path, "is not absolute");
  const std::vector<std::string> names = absl::StrSplit(path.substr(1), '/');
  UniqueFd at(openat(root_fd, ".", O_PATH | O_DIRECTORY | O_CLOEXEC));
  struct stat info;
  if (at.get() < 0 || fstat(at.get(), &info) != 0) {
    return absl::UnavailableError("cannot open the root directory");
  }
  RIPS_RETURN_IF_ERROR(CheckComponent(info, "/", false));
  std::string walked;
  for (size_t i = 0; i < names.size(); ++i) {
    if (names[i].empty() || names[i] == "." || names[i] == "..") {
      return Unsafe(path, "has an empty, `.` or `..` component");
    }
    absl::StrAppend(&walked, "/", names[i]);
    UniqueFd next(openat(at.get(), names[i].c_str(), O_PATH | O_NOFOLLOW | O_CLOEXEC));
    if (next.get() < 0 || fstat(next.get(), &info) != 0) {
      return absl::NotFoundError(absl::StrCat(Quote(walked), ": ", std::strerror(errno)));
    }
    RIPS_RETURN_IF_ERROR(CheckComponent(info, walked, i + 1 == names.size()));
    at = std::move(next);
  }
  return absl::OkStatus();
}

struct PosixRunner::Run {
  const ProgramSpec* spec = nullptr;
  Done done;
  pid_t pid = 0;
  UniqueFd pidfd;
  UniqueFd output;
  int64_t started_ns = 0;
  int64_t deadline_ns = 0;
  int64_t kill_at_ns = 0;  // 0 = not told to end yet
  std::atomic<bool> cancel = false;
  bool timed_out = false;
  bool killed = false;
  ProgramResult result;

  void Read() {
    char buffer[16 << 10];
    for (size_t taken = 0; output.get() >= 0 && taken < kReadBytesPerTurn;) {
      const ssize_t got = read(output.get(), buffer, sizeof(buffer));
      if (got > 0) {
        taken += got;
        result.output_bytes += got;
        result.output_tail.append(buffer, got);
        if (result.output_tail.size() > 2 * kOutputBytesMax) Trim();
      } else if (got == 0 || (errno != EAGAIN && errno != EINTR)) {
        output.Reset();
      } else if (errno == EAGAIN) {
        return;
      }
    }
  }
  void Trim() {
    if (result.output_tail.size() <= kOutputBytesMax) return;
    result.output_tail.erase(0, result.output_tail.size() - kOutputBytesMax);
  }
};

absl::StatusOr<std::unique_ptr<PosixRunner>> PosixRunner::Create(std::vector<ProgramSpec> allowed,
                                                                 const Clock* clock) {
  const int wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  if (wake_fd < 0) return absl::UnavailableError("eventfd failed");
  return std::unique_ptr<PosixRunner>(new PosixRunner(std::move(allowed), clock, wake_fd));
}

PosixRunner::PosixRunner(std::vector<ProgramSpec> allowed, const Clock* clock, int wake_fd)
    : allowed_(std::move(allowed)), clock_(clock), wake_fd_(wake_fd) {
  thread_ = std::thread([this] { Loop(); });
}

PosixRunner::~PosixRunner() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
  }
  Wake();
  thread_.join();
  close(wake_fd_);
}

void PosixRunner::Wake() const {
  const uint64_t one = 1;
  // Full means that a wake-up is pending already.
  [[maybe_unused]] const ssize_t written = write(wake_fd_, &one, sizeof(one));
}

absl::StatusOr<const ProgramSpec*> PosixRunner::Find(absl::string_view name) const {
  const auto spec = std::find_if(allowed_.begin(), allowed_.end(),
                                 [&](const ProgramSpec& each) { return each.name == name; });
  if (spec != allowed_.end()) return &*spec;
  return absl::PermissionDeniedError(
      absl::StrCat("program ", Quote(name), " is not in the allow-list"));
}

absl::Status PosixRunner::Examine(absl::string_view name) {
  RIPS_ASSIGN_OR_RETURN(const ProgramSpec* spec, Find(name));
  const UniqueFd root(open("/", O_PATH | O_DIRECTORY | O_CLOEXEC));
  return CheckProgramPath(root.get(), spec->path);
}

absl::StatusOr<const ProgramSpec*> PosixRunner::Admit(const ProgramRequest& request) const {
  RIPS_ASSIGN_OR_RETURN(const ProgramSpec* spec, Find(request.name));
  if (request.args.size() > kArgsMax) {
    return absl::InvalidArgumentError(
        absl::StrCat(request.args.size(), " arguments exceed limit ", kArgsMax));
  }
  for (const std::string& arg : request.args) {
    if (arg.size() > kArgBytesMax) {
      return absl::InvalidArgumentError(
          absl::StrCat("an argument of ", arg.size(), " bytes exceeds limit ", kArgBytesMax));
    }
    if (arg.find('\0') != std::string::npos) {
      return absl::InvalidArgumentError("an argument holds a NUL byte");
    }
  }
  UniqueFd root(open("/", O_PATH | O_DIRECTORY | O_CLOEXEC));
  RIPS_RETURN_IF_ERROR(CheckProgramPath(root.get(), spec->path));
  return spec;
}

absl::StatusOr<uint64_t> PosixRunner::Start(const ProgramRequest& request, Done done) {
  RIPS_ASSIGN_OR_RETURN(const ProgramSpec* spec, Admit(request));
  auto run = std::make_shared<Run>();
  run->spec = spec;
  run->done = std::move(done);
  int pipe_fds[2];
  if (pipe2(pipe_fds, O_CLOEXEC) != 0) return absl::UnavailableError("pipe failed");
  run->output = UniqueFd(pipe_fds[0]);
  const UniqueFd child_end(pipe_fds[1]);
  fcntl(run->output.get(), F_SETFL, O_NONBLOCK);

  MutexLock lock(&mu_);
  int same = 0;
  for (const auto& [id, other] : runs_) same += other->spec == spec ? 1 : 0;
  if (stopping_) return absl::UnavailableError("stopping");
  if (same >= spec->concurrency) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "program ", Quote(spec->name), " runs already, concurrency limit ", spec->concurrency));
  }
  if (runs_.size() >= static_cast<size_t>(kRunsMax)) {
    return absl::ResourceExhaustedError(absl::StrCat("running programs exceed limit ", kRunsMax));
  }
  const int error =
      SpawnSetup(child_end.get()).Spawn(spec->path, request.args, request.drill, &run->pid);
  if (error != 0) {
    return absl::UnavailableError(
        absl::StrCat("cannot start ", Quote(spec->path), ": ", std::strerror(error)));
  }
  // Free of races: nobody else waits for children, so the process cannot have been reaped.
  run->pidfd = UniqueFd(static_cast<int>(syscall(SYS_pidfd_open, run->pid, 0)));
  run->started_ns = clock_->Now().boottime_ns;
  run->deadline_ns =
      run->started_ns + absl::ToInt64Nanoseconds(std::min(request.timeout, spec->timeout));
  const uint64_t id = next_run_++;
  runs_.emplace(id, std::move(run));
  Wake();
  return id;
}

void PosixRunner::Cancel(uint64_t id) {
  MutexLock lock(&mu_);
  const auto run = runs_.find(id);
  if (run == runs_.end()) return;
  run->second->cancel = true;
  Wake();
}

void PosixRunner::Loop() {
  while (true) {
    bool stopping = false;
    {
      MutexLock lock(&mu_);
      stopping = stopping_;
      if (stopping && runs_.empty()) return;
    }
    PollOnce(StepAll(stopping));
  }
}

int PosixRunner::StepAll(bool stopping) {
  std::vector<std::pair<uint64_t, std::shared_ptr<Run>>> runs;
  {
    MutexLock lock(&mu_);
    runs.assign(runs_.begin(), runs_.end());
  }
  int wait_ms = kPollMsMax;
  for (const auto& [id, run] : runs) {
    const int64_t now_ns = clock_->Now().boottime_ns;
    if (stopping && !run->killed) {
      run->cancel = true;
      run->killed = true;
      kill(-run->pid, SIGKILL);
    }
    run->Read();
    Enforce(*run, now_ns);
    if (TryReap(*run, now_ns)) {
      {
        MutexLock lock(&mu_);
        runs_.erase(id);
      }
      run->done(std::move(run->result));
      continue;
    }
    const int64_t next_ns = run->kill_at_ns != 0 ? run->kill_at_ns : run->deadline_ns;
    if (!run->killed) {
      wait_ms = std::clamp<int64_t>((next_ns - now_ns) / kNanosPerMilli + 1, 0, wait_ms);
    }
    if (run->pidfd.get() < 0) wait_ms = std::min(wait_ms, 10);
  }
  return wait_ms;
}

void PosixRunner::Enforce(Run& run, int64_t now_ns) {
  if (run.killed) return;
  if (run.kill_at_ns == 0) {
    run.timed_out = now_ns >= run.deadline_ns;
    if (!run.timed_out && !run.cancel) return;
    run.kill_at_ns = now_ns + absl::ToInt64Nanoseconds(kTermGrace);
    kill(-run.pid, SIGTERM);
  } else if (now_ns >= run.kill_at_ns) {
    run.killed = true;
    kill(-run.pid, SIGKILL);
  }
}

bool PosixRunner::TryReap(Run& run, int64_t now_ns) {
  siginfo_t info;
  info.si_pid = 0;
  // Looked at first and reaped after the group is killed: until then its number is not reused.
  if (waitid(P_PID, run.pid, &info, WEXITED | WNOHANG | WNOWAIT) != 0 || info.si_pid == 0) {
    return false;
  }
  kill(-run.pid, SIGKILL);
  waitid(P_PID, run.pid, &info, WEXITED);
  run.Read();
  run.Trim();
  ProgramResult& result = run.result;
  const bool exited = info.si_code == CLD_EXITED;
  result.exit_code = exited ? info.si_status : 128 + info.si_status;
  result.took_ms = static_cast<uint32_t>((now_ns - run.started_ns) / kNanosPerMilli);
  if (run.timed_out) {
    result.status = absl::DeadlineExceededError(
        absl::StrCat("killed after ",
                     absl::FormatDuration(absl::Nanoseconds(run.deadline_ns - run.started_ns))));
  } else if (run.cancel) {
    result.status = absl::CancelledError("cancelled");
  } else if (!exited) {
    result.status = absl::AbortedError(absl::StrCat("ended by signal ", info.si_status));
  } else if (info.si_status != 0) {
    result.status = absl::AbortedError(absl::StrCat("exit code ", info.si_status));
  }
  return true;
}

void PosixRunner::PollOnce(int timeout_ms) {
  std::vector<std::shared_ptr<Run>> runs;  // keeps the descriptors open while polling
  std::vector<pollfd> fds = {{wake_fd_, POLLIN, 0}};
  {
    MutexLock lock(&mu_);
    for (const auto& [id, run] : runs_) runs.push_back(run);
  }
  for (const auto& run : runs) {
    if (run->pidfd.get() >= 0) fds.push_back({run->pidfd.get(), POLLIN, 0});
    if (run->output.get() >= 0) fds.push_back({run->output.get(), POLLIN, 0});
  }
  poll(fds.data(), fds.size(), timeout_ms);
  uint64_t drained;
  [[maybe_unused]] const ssize_t got = read(wake_fd_, &drained, sizeof(drained));
}

}  // namespace rips::actuator
