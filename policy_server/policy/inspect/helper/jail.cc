#include "policy_server/policy/inspect/helper/jail.h"

#include <dirent.h>
#include <fcntl.h>
#include <linux/sched.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

#include "policy_server/policy/inspect/confine.h"
#include "policy_server/policy/inspect/helper/landlock.h"
#include "policy_server/policy/inspect/helper/seccomp_filter.h"

namespace rips::inspect {
namespace {

constexpr int kExitFailed = 125;

enum class Kind { kUserAndPid, kPid, kNone };

bool IsRoot() { return geteuid() == 0; }

// Ends as a process with wait status `status` did.
[[noreturn]] void EndAs(int status) {
  if (WIFEXITED(status)) _exit(WEXITSTATUS(status));
  kill(getpid(), SIGKILL);
  _exit(kExitFailed);
}

bool WriteAll(const std::string& path, const std::string& text) {
  const int file = open(path.c_str(), O_WRONLY | O_CLOEXEC);
  if (file < 0) return false;
  const bool good = write(file, text.data(), text.size()) == static_cast<ssize_t>(text.size());
  close(file);
  return good;
}

std::string OneId(id_t id) { return std::to_string(id) + " " + std::to_string(id) + " 1"; }

// As absl::CHexEscape.
std::string Printable(const std::string& text) {
  std::string out;
  for (const char byte : text) {
    char escaped[8] = {byte};
    const auto code = static_cast<unsigned char>(byte);
    if (code < 0x20 || code > 0x7e) std::snprintf(escaped, sizeof(escaped), "\\x%02x", code);
    out += escaped;
  }
  return out;
}

// Its one user is the one that the program runs as; nobody else exists in it.
bool MapIds(pid_t child, const JailSpec& spec) {
  const std::string proc = "/proc/" + std::to_string(child);
  const uid_t uid = spec.ids ? spec.ids->uid : geteuid();
  const gid_t gid = spec.ids ? spec.ids->gid : getegid();
  // Else a user could give up a group that denies something; so groups stay.
  if (!IsRoot() && !WriteAll(proc + "/setgroups", "deny")) return false;
  return WriteAll(proc + "/uid_map", OneId(uid)) && WriteAll(proc + "/gid_map", OneId(gid));
}

[[noreturn]] void BecomeProgram(const JailSpec& spec, Kind kind) {
  if (prctl(PR_SET_PDEATHSIG, SIGKILL) != 0) FailJail("cannot be tied to its parent");
  ForbidNewRights();
  std::vector<std::string> readable = SystemReadable();
  readable.insert(readable.end(), spec.readable.begin(), spec.readable.end());
  const std::string missing = ApplyLandlock(
      readable, {"/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom"});
  if (!missing.empty()) ReportMissing(missing);
  const auto profile =
      kind == Kind::kNone ? SeccompProfile::kPluginWithoutPidNamespace : SeccompProfile::kPlugin;
  std::string program = spec.program;
  char* const argv[] = {program.data(), nullptr};
  ApplyLimits(spec, /*limit_tasks=*/kind == Kind::kUserAndPid || (kind == Kind::kPid && spec.ids));
  if (const int error = ApplySeccomp(profile); error != 0) {
    FailJail(std::string("cannot filter its system calls: ") + std::strerror(error));
  }
  if (spec.mode == "probe") _exit(0);
  execve(program.c_str(), argv, environ);
  const int error = errno;
  std::string why = "cannot execute `" + Printable(program) + "`: " + std::strerror(error);
  if (error == EACCES && spec.ids) {
    why += "; user " + std::to_string(spec.ids->uid) +
           ", whom plugins run as, must be able to read it";
  }
  FailJail(why);
}

void CloseOurs() {
  for (const int fd : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO, kReportFd}) close(fd);
}

// Process 1 of the namespace. `go` tells that its ids are mapped, and later that its parent is
// gone.
[[noreturn]] void RunInit(const JailSpec& spec, Kind kind, int go, int status_fd) {
  char byte = 0;
  if (read(go, &byte, 1) != 1) _exit(kExitFailed);
  DropRights(spec, /*may_drop_groups=*/kind == Kind::kPid || byte == 'g');
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  pollfd parent = {.fd = go, .events = 0, .revents = 0};
  if (poll(&parent, 1, 0) != 0) _exit(kExitFailed);  // it went before we were tied to it
  const pid_t program = fork();
  if (program == 0) BecomeProgram(spec, kind);
  if (program < 0) FailJailWithErrno("cannot make a process");
  CloseOurs();
  int status = 0;
  pid_t ended;
  do {
    ended = waitpid(-1, &status, 0);
  } while (ended != program && (ended > 0 || errno == EINTR));
  [[maybe_unused]] const ssize_t written = write(status_fd, &status, sizeof(status));
  _exit(0);  // and with it, all
}

struct Pipe {
  int read = -1;
  int write = -1;
};

Pipe MakePipe() {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) {
    FailJailWithErrno("no descriptor");
  }
  return {.read = ends[0], .write = ends[1]};
}

// Returns only if the namespaces cannot be had.
void RunInNamespaces(const JailSpec& spec, Kind kind) {
  const Pipe go = MakePipe();
  const Pipe result = MakePipe();
  const unsigned long flags =
      SIGCHLD | CLONE_NEWPID | (kind == Kind::kUserAndPid ? CLONE_NEWUSER : 0);
  const auto init = static_cast<pid_t>(syscall(SYS_clone, flags, 0, 0, 0, 0));
  if (init == 0) {
    close(go.write);
    RunInit(spec, kind, go.read, result.write);
  }
  close(go.read);
  close(result.write);
  const bool mapped = init > 0 && (kind == Kind::kPid || MapIds(init, spec));
  const char byte = IsRoot() ? 'g' : 'k';
  if (!mapped || write(go.write, &byte, 1) != 1) {
    close(go.write);
    if (init > 0) waitpid(init, nullptr, 0);
    close(result.read);
    return;
  }
  CloseOurs();
  int ended = 0;
  while (waitpid(init, &ended, 0) < 0 && errno == EINTR) {
  }
  int status = SIGKILL;  // init was killed
  if (WIFEXITED(ended) && WEXITSTATUS(ended) == kExitFailed) status = ended;
  [[maybe_unused]] const ssize_t got = read(result.read, &status, sizeof(status));
  EndAs(status);
}

void KillChildren() {
  DIR* proc = opendir("/proc");
  if (proc == nullptr) return;
  while (const dirent* entry = readdir(proc)) {
    const int pid = std::atoi(entry->d_name);
    if (pid <= 0) continue;
    std::FILE* stat = std::fopen(("/proc/" + std::to_string(pid) + "/stat").c_str(), "re");
    if (stat == nullptr) continue;
    char text[512] = {};
    const size_t bytes = std::fread(text, 1, sizeof(text) - 1, stat);
    std::fclose(stat);
    // After the name, which may hold anything: `) STATE PPID`.
    const char* name_end = bytes == 0 ? nullptr : std::strrchr(text, ')');
    int parent = 0;
    if (name_end != nullptr && std::sscanf(name_end + 1, " %*c %d", &parent) == 1 &&
        parent == getpid()) {
      kill(pid, SIGKILL);
    }
  }
  closedir(proc);
}

// Whatever was started by what is killed becomes ours, and is killed in the next round.
void Sweep() {
  while (true) {
    KillChildren();
    pid_t reaped;
    while ((reaped = waitpid(-1, nullptr, WNOHANG)) > 0) {
    }
    if (reaped < 0 && errno == ECHILD) return;
    usleep(1000);
  }
}

[[noreturn]] void RunSwept(const JailSpec& spec) {
  constexpr char kSweeps[] = {kReportSweeps, '\n'};
  [[maybe_unused]] const ssize_t told = write(kReportFd, kSweeps, sizeof(kSweeps));
  ReportMissing(
      "no PID namespace: what the program starts is found and killed by its parent, and the number "
      "of its processes is not limited");
  sigset_t watched, before;
  sigemptyset(&watched);
  for (const int number : {SIGTERM, SIGCHLD}) sigaddset(&watched, number);
  sigprocmask(SIG_BLOCK, &watched, &before);
  prctl(PR_SET_CHILD_SUBREAPER, 1);
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  const pid_t program = fork();
  if (program == 0) {
    sigprocmask(SIG_SETMASK, &before, nullptr);
    DropRights(spec, IsRoot());
    BecomeProgram(spec, Kind::kNone);
  }
  if (program < 0) FailJailWithErrno("cannot make a process");
  CloseOurs();
  int end = SIGKILL;
  while (true) {
    int number = 0;
    sigwait(&watched, &number);
    if (number == SIGTERM) break;
    int status = 0;
    pid_t reaped;
    bool ended = false;
    while ((reaped = waitpid(-1, &status, WNOHANG)) > 0) {
      if (reaped != program) continue;
      end = status;
      ended = true;
    }
    if (ended) break;
  }
  Sweep();
  EndAs(end);
}

}  // namespace

void RunJailed(const JailSpec& spec) {
  RunInNamespaces(spec, Kind::kUserAndPid);
  if (IsRoot()) {
    ReportMissing("no user namespace: the limit of processes counts all plugins together");
    RunInNamespaces(spec, Kind::kPid);
  }
  RunSwept(spec);
}

}  // namespace rips::inspect
