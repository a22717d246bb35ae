#include "services/runtime/shutdown.h"

#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include "gtest/gtest.h"
#include "services/runtime/bounded_queue.h"

namespace rips {
namespace {

// Runs `body` in a process of its own, because signals and masks belong to a process.
int ExitCodeOf(int (*body)()) {
  const pid_t child = fork();
  if (child == 0) _exit(body());
  int status = 0;
  EXPECT_EQ(waitpid(child, &status, 0), child);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

TEST(SignalWaiterTest, CallsBackAndEndsOnSigterm) {
  EXPECT_EQ(ExitCodeOf([] {
              BlockSignals();
              BoundedQueue<int> seen({.capacity = 10});
              SignalWaiter waiter(
                  {{SIGHUP, [&] { seen.Push(SIGHUP); }}, {SIGTERM, [&] { seen.Push(SIGTERM); }}});
              kill(getpid(), SIGHUP);
              if (seen.Pop(absl::Seconds(20)) != SIGHUP) return 1;
              kill(getpid(), SIGUSR1);  // no callback: ignored
              kill(getpid(), SIGTERM);
              if (waiter.WaitForShutdown() != SIGTERM) return 2;
              return seen.Pop(absl::ZeroDuration()) == SIGTERM ? 0 : 3;
            }),
            0);
}

TEST(SignalWaiterTest, RemembersASignalFromBeforeTheWait) {
  EXPECT_EQ(ExitCodeOf([] {
              BlockSignals();
              kill(getpid(), SIGINT);
              SignalWaiter waiter({});
              return waiter.WaitForShutdown() == SIGINT ? 0 : 1;
            }),
            0);
}

TEST(SignalWaiterTest, EndsOnRequest) {
  EXPECT_EQ(ExitCodeOf([] {
              BlockSignals();
              SignalWaiter waiter({});
              std::thread part([&] { waiter.RequestShutdown(); });
              const int signal = waiter.WaitForShutdown();
              part.join();
              return signal;
            }),
            0);
}

TEST(SignalWaiterTest, SurvivesABrokenPipe) {
  EXPECT_EQ(ExitCodeOf([] {
              BlockSignals();
              int ends[2];
              if (pipe(ends) != 0) return 1;
              close(ends[0]);
              return write(ends[1], "x", 1) == -1 ? 0 : 2;
            }),
            0);
}

}  // namespace
}  // namespace rips
