#include "services/runtime/core_dumps.h"

#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "gtest/gtest.h"

namespace rips {
namespace {

TEST(CoreDumpsTest, AreForbiddenForTheProcessAndItsChildren) {
  const pid_t child = fork();
  if (child == 0) {
    const rlimit some = {.rlim_cur = 1 << 20, .rlim_max = RLIM_INFINITY};
    setrlimit(RLIMIT_CORE, &some);
    prctl(PR_SET_DUMPABLE, 1, 0, 0, 0);

    ForbidCoreDumps();

    rlimit limit = {};
    getrlimit(RLIMIT_CORE, &limit);
    const bool limited = limit.rlim_cur == 0 && limit.rlim_max == 0;
    _exit(limited && prctl(PR_GET_DUMPABLE, 0, 0, 0, 0) == 0 ? 0 : 1);
  }
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
}

}  // namespace
}  // namespace rips
