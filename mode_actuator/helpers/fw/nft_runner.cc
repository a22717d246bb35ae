#include "mode_actuator/helpers/fw/nft_runner.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "mode_actuator/helpers/fw/ruleset.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {
namespace {

constexpr absl::string_view kNoTable = "No such file or directory";

// `text` in a file without a name, to be read from its start.
absl::StatusOr<UniqueFd> FileOf(absl::string_view text) {
  UniqueFd file(memfd_create("nft", MFD_CLOEXEC));
  if (file.get() < 0) return absl::UnavailableError("memfd_create failed");
  while (!text.empty()) {
    const ssize_t written = write(file.get(), text.data(), text.size());
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return absl::UnavailableError("cannot hold the rules in memory");
    text.remove_prefix(static_cast<size_t>(written));
  }
  lseek(file.get(), 0, SEEK_SET);
  return file;
}

struct Pipe {
  UniqueFd read_end;
  UniqueFd write_end;
};

absl::StatusOr<Pipe> MakePipe() {
  int fds[2];
  if (pipe2(fds, O_CLOEXEC) != 0) return absl::UnavailableError("pipe failed");
  return Pipe{UniqueFd(fds[0]), UniqueFd(fds[1])};
}

// 0, or the error number.
int Spawn(const std::string& path, const std::vector<std::string>& args, int in, int out, int err,
          pid_t* pid) {
  posix_spawn_file_actions_t files;
  posix_spawn_file_actions_init(&files);
  posix_spawn_file_actions_adddup2(&files, in, 0);
  posix_spawn_file_actions_adddup2(&files, out, 1);
  posix_spawn_file_actions_adddup2(&files, err, 2);
  posix_spawn_file_actions_addclosefrom_np(&files, 3);
  posix_spawn_file_actions_addchdir_np(&files, "/");
  posix_spawnattr_t attr;
  posix_spawnattr_init(&attr);
  sigset_t all, none;
  sigfillset(&all);
  sigemptyset(&none);
  posix_spawnattr_setsigdefault(&attr, &all);
  posix_spawnattr_setsigmask(&attr, &none);
  posix_spawnattr_setflags(&attr, POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSIGMASK);
  std::vector<std::string> words = {path};
  words.insert(words.end(), args.begin(), args.end());
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  std::string path_env = "PATH=/usr/sbin:/usr/bin";
  std::string lang_env = "LANG=C";
  char* envp[] = {path_env.data(), lang_env.data(), nullptr};
  const int error = posix_spawn(pid, path.c_str(), &files, &attr, argv.data(), envp);
  posix_spawn_file_actions_destroy(&files);
  posix_spawnattr_destroy(&attr);
  return error;
}

// Reads what is there into `text`; closes at the end of the file.
void Drain(UniqueFd& fd, std::string& text) {
  char buffer[16 << 10];
  const ssize_t got = read(fd.get(), buffer, sizeof(buffer));
  if (got > 0) {
    text.append(buffer, static_cast<size_t>(got));
  } else if (got == 0 || errno != EINTR) {
    fd.Reset();
  }
}

// nft's first two lines say what and where; the rest repeats the text.
std::string Reason(absl::string_view err) {
  return ros2::Printable(err.substr(0, kNftErrorBytesMax));
}

}  // namespace

absl::StatusOr<NftRunner::Ended> NftRunner::Run(const std::vector<std::string>& args,
                                                absl::string_view input) const {
  RIPS_ASSIGN_OR_RETURN(const UniqueFd in, FileOf(input));
  RIPS_ASSIGN_OR_RETURN(Pipe out, MakePipe());
  RIPS_ASSIGN_OR_RETURN(Pipe err, MakePipe());
  pid_t pid = 0;
  const int error =
      Spawn(options_.path, args, in.get(), out.write_end.get(), err.write_end.get(), &pid);
  if (error != 0) {
    return absl::UnavailableError(
        absl::StrCat("cannot start ", options_.path, ": ", std::strerror(error)));
  }
  out.write_end.Reset();
  err.write_end.Reset();
  const int64_t deadline_ns = BoottimeAfter(options_.timeout);
  Ended ended;
  absl::Status status;
  while (out.read_end.get() >= 0 || err.read_end.get() >= 0) {
    const int64_t left_ns = deadline_ns - BoottimeNow();
    if (left_ns <= 0) {
      status = absl::DeadlineExceededError(
          absl::StrCat("nft did not end within ", absl::FormatDuration(options_.timeout)));
      break;
    }
    if (ended.out.size() > kRulesetBytesMax || ended.err.size() > kRulesetBytesMax) {
      status = absl::ResourceExhaustedError(
          absl::StrCat("nft printed more than ", kRulesetBytesMax, " bytes"));
      break;
    }
    pollfd fds[] = {{out.read_end.get(), POLLIN, 0}, {err.read_end.get(), POLLIN, 0}};
    poll(fds, 2, static_cast<int>(std::min<int64_t>(left_ns / kNanosPerMilli + 1, 1000)));
    if (fds[0].revents != 0) Drain(out.read_end, ended.out);
    if (fds[1].revents != 0) Drain(err.read_end, ended.err);
  }
  if (!status.ok()) kill(pid, SIGKILL);
  int code = 0;
  // It has closed its output, so it ends now; one that does not is killed at the deadline.
  while (waitpid(pid, &code, WNOHANG) == 0) {
    if (BoottimeNow() >= deadline_ns) kill(pid, SIGKILL);
    poll(nullptr, 0, 1);
  }
  RIPS_RETURN_IF_ERROR(status);
  ended.exit_code = WIFEXITED(code) ? WEXITSTATUS(code) : 128 + WTERMSIG(code);
  return ended;
}

absl::Status NftRunner::Load(absl::string_view script, NftMode mode) {
  std::vector<std::string> args = {"-f", "-"};
  if (mode == NftMode::kDryRun) args.insert(args.begin(), "-c");
  RIPS_ASSIGN_OR_RETURN(const Ended ended, Run(args, script));
  if (ended.exit_code == 0) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("nft refuses (exit code ", ended.exit_code, "): ", Reason(ended.err)));
}

absl::StatusOr<std::string> NftRunner::ListTable() {
  RIPS_ASSIGN_OR_RETURN(Ended ended, Run({"-j", "list", "table", "inet", "rips"}, ""));
  if (ended.exit_code == 0) return std::move(ended.out);
  if (absl::StrContains(ended.err, kNoTable)) {
    return absl::NotFoundError("table `inet rips` is not there");
  }
  return absl::UnavailableError(
      absl::StrCat("nft cannot list (exit code ", ended.exit_code, "): ", Reason(ended.err)));
}

}  // namespace rips::actuator
