#include "mode_actuator/helpers/exec/posix_runner.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "mode_actuator/helpers/exec/enter.h"
#include "mode_actuator/steps/program/exec_message.h"
#include "mode_actuator/steps/program/program_file.h"
#include "services/base/status_macros.h"
#include "services/runtime/real_clock.h"
#include "services/text/quote.h"

namespace rips::actuator {
namespace {

constexpr int kPollMsMax = 1000;
// Between two looks whether what was killed is gone.
constexpr int kGonePollMs = 2;
// Read from one program before the others get a turn.
constexpr size_t kReadBytesPerTurn = 1 << 20;

// A copy whose number no descriptor of the new process has.
UniqueFd OutOfTheWay(int fd) { return UniqueFd(fcntl(fd, F_DUPFD_CLOEXEC, kEnterReportFd + 1)); }

// The attributes and descriptors every program starts with.
class SpawnSetup {
 public:
  SpawnSetup(int output_fd, int program_fd, int cgroup_fd, int report_fd)
      : output_(OutOfTheWay(output_fd)),
        program_(OutOfTheWay(program_fd)),
        cgroup_(OutOfTheWay(cgroup_fd)),
        report_(OutOfTheWay(report_fd)) {
    posix_spawn_file_actions_init(&files_);
    posix_spawn_file_actions_addopen(&files_, 0, "/dev/null", O_RDONLY, 0);
    posix_spawn_file_actions_adddup2(&files_, output_.get(), 1);
    posix_spawn_file_actions_adddup2(&files_, output_.get(), 2);
    posix_spawn_file_actions_adddup2(&files_, program_.get(), kEnterProgramFd);
    posix_spawn_file_actions_adddup2(&files_, cgroup_.get(), kEnterCgroupFd);
    posix_spawn_file_actions_adddup2(&files_, report_.get(), kEnterReportFd);
    posix_spawn_file_actions_addclosefrom_np(&files_, kEnterReportFd + 1);
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
  int Spawn(const std::string& path, std::vector<std::string> words,
            std::vector<std::string> environment, pid_t* pid) {
    std::vector<char*> argv = Pointers(words);
    std::vector<char*> envp = Pointers(environment);
    return posix_spawn(pid, path.c_str(), &files_, &attr_, argv.data(), envp.data());
  }

 private:
  static std::vector<char*> Pointers(std::vector<std::string>& words) {
    std::vector<char*> pointers;
    for (std::string& word : words) pointers.push_back(word.data());
    pointers.push_back(nullptr);
    return pointers;
  }

  const UniqueFd output_, program_, cgroup_, report_;
  posix_spawn_file_actions_t files_;
  posix_spawnattr_t attr_;
};

std::vector<std::string> Environment(const PosixRunnerOptions& options,
                                     const ProgramRequest& request) {
  std::vector<std::string> environment = {"PATH=/usr/sbin:/usr/bin", "LANG=C.UTF-8"};
  const std::pair<absl::string_view, absl::string_view> known[] = {
      {"RIPS_ROBOT", options.robot},
      {"RIPS_HOST", options.host},
      {"RIPS_LEVEL_FROM", request.level_from},
      {"RIPS_LEVEL_TO", request.level_to},
      {"RIPS_DRILL", request.drill ? "1" : ""}};
  for (const auto& [name, value] : known) {
    if (!value.empty()) environment.push_back(absl::StrCat(name, "=", value));
  }
  return environment;
}

// OK if the other end was closed by the program's own start.
absl::Status ReadReport(int fd) {
  const int64_t until_ns = BoottimeAfter(kEnterTimeout);
  std::string report;
  char buffer[512];
  while (true) {
    pollfd poll_fd = {fd, POLLIN, 0};
    const int64_t left_ns = until_ns - BoottimeNow();
    if (left_ns <= 0) {
      return absl::UnavailableError(
          absl::StrCat("it did not start within ", absl::FormatDuration(kEnterTimeout)));
    }
    if (poll(&poll_fd, 1, static_cast<int>(left_ns / kNanosPerMilli + 1)) <= 0) continue;
    const ssize_t got = read(fd, buffer, sizeof(buffer));
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0 || report.size() > sizeof(buffer)) break;
    report.append(buffer, static_cast<size_t>(got));
  }
  if (report == absl::string_view(&kEnterReady, 1)) return absl::OkStatus();
  if (report.empty()) return absl::UnavailableError("rips-exec ended before it became the program");
  return absl::UnavailableError(report.substr(report.front() == kEnterReady ? 1 : 0));
}

}  // namespace

struct PosixRunner::Run {
  const ProgramSpec* spec = nullptr;
  Done done;
  pid_t pid = 0;
  UniqueFd pidfd;
  UniqueFd output;
  std::unique_ptr<RunCgroup> cgroup;  // null: its process group must do
  int64_t started_ns = 0;
  int64_t deadline_ns = 0;
  int64_t kill_at_ns = 0;  // 0 = not asked to end yet
  std::atomic<bool> cancel = false;
  bool timed_out = false;
  bool killed = false;
  bool reaped = false;
  int64_t wait_until_ns = 0;  // for what was left behind to be gone; once reaped
  ProgramResult result;

  void KillAll() {
    if (cgroup != nullptr) cgroup->Kill();
    if (!reaped) kill(-pid, SIGKILL);
  }

  void Read() {
    char buffer[64 << 10];  // as much as a pipe holds
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

PosixRunner::PosixRunner(PosixRunnerOptions options, const Clock* clock)
    : options_(std::move(options)), clock_(clock) {
  thread_ = std::thread([this] { Loop(); });
}

PosixRunner::~PosixRunner() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
  }
  wake_.Wake();
  thread_.join();
}

absl::StatusOr<const ProgramSpec*> PosixRunner::Find(absl::string_view name) const {
  if (const ProgramSpec* spec = FindNamed(options_.allowed, name)) return spec;
  return absl::PermissionDeniedError(
      absl::StrCat("program ", QuoteBytes(name), " is not in the allow-list"));
}

absl::StatusOr<UniqueFd> PosixRunner::Open(const ProgramSpec& spec) const {
  const UniqueFd root(open("/", O_PATH | O_DIRECTORY | O_CLOEXEC));
  RIPS_ASSIGN_OR_RETURN(UniqueFd file, OpenProgram(root.get(), spec.path));
  if (spec.sha256.empty()) return file;
  const absl::Status same = CheckSha256(file.get(), spec.sha256);
  if (same.ok()) return file;
  return absl::Status(same.code(), absl::StrCat(QuoteBytes(spec.path), ": ", same.message()));
}

absl::Status PosixRunner::Examine(absl::string_view name) {
  RIPS_ASSIGN_OR_RETURN(const ProgramSpec* spec, Find(name));
  return Open(*spec).status();
}

absl::Status PosixRunner::CheckLimits(const ProgramSpec& spec) {
  {
    MutexLock lock(&mu_);
    int same = 0;
    for (const auto& [id, other] : runs_) same += other->spec == &spec ? 1 : 0;
    if (stopping_) return absl::UnavailableError("stopping");
    if (same >= spec.concurrency) {
      return absl::ResourceExhaustedError(absl::StrCat("program ", QuoteBytes(spec.name),
                                                       " runs already, concurrency limit ",
                                                       spec.concurrency));
    }
    if (runs_.size() >= static_cast<size_t>(kRunsMax)) {
      return absl::ResourceExhaustedError(absl::StrCat("running programs exceed limit ", kRunsMax));
    }
  }
  if (spec.starts_per_minute == 0) return absl::OkStatus();
  std::deque<int64_t>& starts = starts_[&spec];
  const int64_t now_ns = clock_->Now().boottime_ns;
  while (!starts.empty() && now_ns - starts.front() >= 60 * kNanosPerSecond) starts.pop_front();
  if (starts.size() >= static_cast<size_t>(spec.starts_per_minute)) {
    return absl::ResourceExhaustedError(
        absl::StrCat("program ", QuoteBytes(spec.name), " was started ", starts.size(),
                     " times within a minute, rate limit ", spec.starts_per_minute, "/min"));
  }
  starts.push_back(now_ns);
  return absl::OkStatus();
}

absl::Status PosixRunner::Spawn(const ProgramRequest& request, int program_fd, Run& run) const {
  int output[2], report[2];
  if (pipe2(output, O_CLOEXEC) != 0) return absl::UnavailableError("pipe failed");
  run.output = UniqueFd(output[0]);
  UniqueFd child_output(output[1]);
  if (pipe2(report, O_CLOEXEC) != 0) return absl::UnavailableError("pipe failed");
  const UniqueFd report_end(report[0]);
  UniqueFd child_report(report[1]);
  fcntl(run.output.get(), F_SETFL, O_NONBLOCK);
  UniqueFd procs(open("/dev/null", O_WRONLY | O_CLOEXEC));
  if (options_.cgroups != nullptr) {
    RIPS_ASSIGN_OR_RETURN(run.cgroup, options_.cgroups->Make());
    RIPS_ASSIGN_OR_RETURN(procs, run.cgroup->OpenProcs());
  }
  std::vector<std::string> words = {"rips-exec", kEnterFlag, run.spec->path};
  words.insert(words.end(), request.args.begin(), request.args.end());
  const int error =
      SpawnSetup(child_output.get(), program_fd, procs.get(), child_report.get())
          .Spawn(options_.enter, std::move(words), Environment(options_, request), &run.pid);
  if (error != 0) {
    return absl::UnavailableError(
        absl::StrCat("cannot start ", QuoteBytes(options_.enter), ": ", std::strerror(error)));
  }
  child_output.Reset();
  child_report.Reset();
  const absl::Status started = ReadReport(report_end.get());
  if (started.ok()) return started;
  run.KillAll();
  siginfo_t info;
  waitid(P_PID, run.pid, &info, WEXITED);
  return absl::UnavailableError(
      absl::StrCat("cannot start ", QuoteBytes(run.spec->path), ": ", started.message()));
}

absl::StatusOr<uint64_t> PosixRunner::Start(const ProgramRequest& request, Done done) {
  RIPS_ASSIGN_OR_RETURN(const ProgramSpec* spec, Find(request.name));
  if (request.drill && !spec->drill) {
    return absl::PermissionDeniedError(
        absl::StrCat("program ", QuoteBytes(spec->name), " may not be run as a drill"));
  }
  RIPS_RETURN_IF_ERROR(CheckProgramArgs(request.args));
  RIPS_ASSIGN_OR_RETURN(const UniqueFd file, Open(*spec));
  MutexLock start_lock(&start_mu_);
  RIPS_RETURN_IF_ERROR(CheckLimits(*spec));
  auto run = std::make_shared<Run>();
  run->spec = spec;
  run->done = std::move(done);
  RIPS_RETURN_IF_ERROR(Spawn(request, file.get(), *run));
  run->started_ns = clock_->Now().boottime_ns;
  run->deadline_ns =
      run->started_ns + absl::ToInt64Nanoseconds(std::min(request.timeout, spec->timeout));
  // Free of races: no other thread waits for children, so the process cannot have been reaped.
  run->pidfd = UniqueFd(static_cast<int>(syscall(SYS_pidfd_open, run->pid, 0)));
  MutexLock lock(&mu_);
  const uint64_t id = next_run_++;
  runs_.emplace(id, std::move(run));
  wake_.Wake();
  return id;
}

void PosixRunner::Cancel(uint64_t id) {
  MutexLock lock(&mu_);
  const auto run = runs_.find(id);
  if (run == runs_.end()) return;
  run->second->cancel = true;
  wake_.Wake();
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
      run->KillAll();
    }
    run->Read();
    Enforce(*run, now_ns);
    if (TryReap(*run, now_ns)) {
      {
        MutexLock lock(&mu_);
        runs_.erase(id);
      }
      run->done(std::move(run->result));
      wait_ms = 0;
      continue;
    }
    const int64_t next_ns = run->kill_at_ns != 0 ? run->kill_at_ns : run->deadline_ns;
    if (run->reaped) {
      wait_ms = std::min(wait_ms, kGonePollMs);
    } else if (!run->killed) {
      wait_ms = std::clamp<int64_t>((next_ns - now_ns) / kNanosPerMilli + 1, 0, wait_ms);
    }
    if (!run->reaped && run->pidfd.get() < 0) wait_ms = std::min(wait_ms, 10);
  }
  return wait_ms;
}

void PosixRunner::Enforce(Run& run, int64_t now_ns) {
  if (run.killed || run.reaped) return;
  if (run.kill_at_ns == 0) {
    run.timed_out = now_ns >= run.deadline_ns;
    if (!run.timed_out && !run.cancel) return;
    run.kill_at_ns = now_ns + absl::ToInt64Nanoseconds(kTermGrace);
    kill(-run.pid, SIGTERM);
  } else if (now_ns >= run.kill_at_ns) {
    run.killed = true;
    run.KillAll();
  }
}

bool PosixRunner::TryReap(Run& run, int64_t now_ns) {
  if (!run.reaped && !Reap(run, now_ns)) return false;
  return run.cgroup == nullptr || now_ns >= run.wait_until_ns || !run.cgroup->Populated();
}

bool PosixRunner::Reap(Run& run, int64_t now_ns) {
  siginfo_t info;
  info.si_pid = 0;
  // Looked at first and reaped after the group is killed: until then its number is not reused.
  if (waitid(P_PID, run.pid, &info, WEXITED | WNOHANG | WNOWAIT) != 0 || info.si_pid == 0) {
    return false;
  }
  ProgramResult& result = run.result;
  // A process that was signalled is not counted: it may be about to end.
  const bool by_itself = run.kill_at_ns == 0 && !run.killed;
  const int left = by_itself && run.cgroup != nullptr ? run.cgroup->Count() : 0;
  if (left > 0)
    result.note =
        absl::StrCat("left ", left, left == 1 ? " process" : " processes", " behind, killed");
  run.KillAll();
  waitid(P_PID, run.pid, &info, WEXITED);
  run.reaped = true;
  run.pidfd.Reset();
  run.wait_until_ns = now_ns + absl::ToInt64Nanoseconds(kGoneWait);
  run.Read();
  run.Trim();
  run.output.Reset();
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
  std::vector<pollfd> fds = {{wake_.get(), POLLIN, 0}};
  {
    MutexLock lock(&mu_);
    for (const auto& [id, run] : runs_) runs.push_back(run);
  }
  for (const auto& run : runs) {
    if (run->pidfd.get() >= 0) fds.push_back({run->pidfd.get(), POLLIN, 0});
    if (run->output.get() >= 0) fds.push_back({run->output.get(), POLLIN, 0});
  }
  poll(fds.data(), fds.size(), timeout_ms);
  wake_.Drain();
}

}  // namespace rips::actuator
