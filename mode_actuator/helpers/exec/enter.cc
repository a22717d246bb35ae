#include "mode_actuator/helpers/exec/enter.h"

#include <fcntl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string>

namespace rips::actuator {
namespace {

constexpr int kCannotStart = 126;  // as a shell says it

int Fail(const char* what) {
  const std::string why = std::string(what) + ": " + std::strerror(errno);
  [[maybe_unused]] const ssize_t written = write(kEnterReportFd, why.data(), why.size());
  return kCannotStart;
}

}  // namespace

bool IsEnter(int argc, char* const* argv) {
  return argc >= 3 && std::strcmp(argv[1], kEnterFlag) == 0;
}

int EnterAndExec(int argc, char** argv) {
  if (argc < 3) return kCannotStart;
  for (const int fd : {kEnterCgroupFd, kEnterReportFd}) fcntl(fd, F_SETFD, FD_CLOEXEC);
  // `0` is the process that writes it.
  if (write(kEnterCgroupFd, "0", 1) != 1) return Fail("cannot enter its cgroup");
  const rlimit none = {0, 0};
  if (setrlimit(RLIMIT_CORE, &none) != 0) return Fail("cannot forbid core dumps");
  char start[2] = {};
  const bool script = pread(kEnterProgramFd, start, sizeof(start), 0) == sizeof(start) &&
                      start[0] == '#' && start[1] == '!';
  if (!script) fcntl(kEnterProgramFd, F_SETFD, FD_CLOEXEC);
  if (write(kEnterReportFd, &kEnterReady, 1) != 1) return kCannotStart;
  execveat(kEnterProgramFd, "", argv + 2, environ, AT_EMPTY_PATH);
  return Fail("cannot be executed");
}

}  // namespace rips::actuator
