#include "services/runtime/core_dumps.h"

#include <sys/prctl.h>
#include <sys/resource.h>

#include <cerrno>
#include <cstring>

#include "services/runtime/log.h"

namespace rips {

void ForbidCoreDumps() {
  // A core_pattern that is a pipe does not ask for the limit; it does ask whether it may dump.
  const rlimit none = {.rlim_cur = 0, .rlim_max = 0};
  if (setrlimit(RLIMIT_CORE, &none) == 0 && prctl(PR_SET_DUMPABLE, 0, 0, 0, 0) == 0) return;
  LogError("cannot disable core dumps; a dump may contain keys", {{"error", std::strerror(errno)}});
}

}  // namespace rips
