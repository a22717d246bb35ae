#include "services/runtime/daemon_log.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <functional>
#include <string>
#include <system_error>
#include <thread>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/check.h"
#include "services/runtime/log_writer.h"
#include "services/runtime/unique_fd.h"

namespace rips {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

struct Ended {
  int status = 0;  // of waitpid
  std::string log;
};

// Runs `body` and exit(0) in a process whose standard error is a pipe, which is read once the
// process has ended, so that it is full after 64 KiB.
Ended RunDaemon(const std::function<void()>& body, bool full = false) {
  int ends[2];
  EXPECT_EQ(pipe2(ends, O_CLOEXEC), 0);
  const UniqueFd read_end(ends[0]);
  UniqueFd write_end(ends[1]);
  if (full) {
    while (TryWriteToLog(write_end.get(), std::string(4'095, 'x') + "\n")) {
    }
  }
  const pid_t pid = fork();
  if (pid == 0) {
    dup2(write_end.get(), STDERR_FILENO);
    write_end.Reset();
    StartLogWriter();
    body();
    std::exit(0);
  }
  write_end.Reset();
  Ended ended;
  EXPECT_EQ(waitpid(pid, &ended.status, 0), pid);
  char piece[4'096];
  for (ssize_t got = 0; (got = read(read_end.get(), piece, sizeof(piece))) > 0;) {
    ended.log.append(piece, static_cast<size_t>(got));
  }
  return ended;
}

bool Exited(const Ended& ended, int code = 0) {
  return WIFEXITED(ended.status) && WEXITSTATUS(ended.status) == code;
}

TEST(DaemonLogTest, ExitWaitsForWhatIsQueued) {
  const Ended ended = RunDaemon([] {
    for (int i = 0; i < 100; ++i) LogInfo("working", {{"turn", i}});
    std::fprintf(stderr, "a line of a library\n");
  });

  EXPECT_TRUE(Exited(ended));
  EXPECT_THAT(ended.log,
              AllOf(HasSubstr("info working turn=0\n"), HasSubstr("info working turn=99\n"),
                    HasSubstr("a line of a library\n")));
}

TEST(DaemonLogTest, ExitWaitsForNoReaderThatHasStopped) {
  const Ended ended = RunDaemon(
      [] {
        for (int i = 0; i < 10'000; ++i) LogInfo("working", {{"turn", i}});
        for (int i = 0; i < 10'000; ++i) std::fprintf(stderr, "a line of a library\n");
        if (LogLinesDropped() == 0) std::exit(1);
      },
      /*full=*/true);

  EXPECT_TRUE(Exited(ended)) << ended.status;
}

TEST(DaemonLogTest, AFailedCheckIsReadBeforeTheProcessEnds) {
  const Ended ended = RunDaemon([] { RIPS_CHECK(false, "told"); });

  EXPECT_TRUE(WIFSIGNALED(ended.status) && WTERMSIG(ended.status) == SIGABRT);
  EXPECT_THAT(ended.log, HasSubstr("check failed: false: told\n"));
}

TEST(DaemonLogTest, AbortWaitsForNoReaderThatHasStopped) {
  const Ended ended = RunDaemon([] { std::abort(); }, /*full=*/true);

  EXPECT_TRUE(WIFSIGNALED(ended.status) && WTERMSIG(ended.status) == SIGABRT);
}

TEST(DaemonLogTest, AWatchdogsSigabrtEndsTheProcess) {
  const Ended ended = RunDaemon([] {
    kill(getpid(), SIGABRT);
    std::exit(1);
  });

  EXPECT_TRUE(WIFSIGNALED(ended.status) && WTERMSIG(ended.status) == SIGABRT);
}

TEST(DaemonLogTest, AThreadThatCannotBeStartedIsAnErrorThatNamesTheLimit) {
  const Ended ended = RunDaemon([] {
    std::thread([] {
      throw std::system_error(std::make_error_code(std::errc::resource_unavailable_try_again));
    }).join();
  });

  EXPECT_TRUE(WIFSIGNALED(ended.status) && WTERMSIG(ended.status) == SIGABRT);
  EXPECT_THAT(ended.log, HasSubstr("error cannot start a thread: a limit of processes"));
}

// As after Ctrl-S.
TEST(DaemonLogTest, ATerminalThatIsStoppedStopsNothing) {
  const UniqueFd terminal(posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC));
  if (terminal.get() < 0 || grantpt(terminal.get()) != 0 || unlockpt(terminal.get()) != 0) {
    GTEST_SKIP() << "no terminals here";
  }
  const UniqueFd shown(open(ptsname(terminal.get()), O_RDWR | O_NOCTTY | O_CLOEXEC));
  ASSERT_GE(shown.get(), 0);
  ASSERT_EQ(tcflow(shown.get(), TCOOFF), 0);
  const pid_t pid = fork();
  if (pid == 0) {
    dup2(shown.get(), STDERR_FILENO);
    StartLogWriter();
    for (int i = 0; i < 10'000; ++i) LogInfo("working", {{"turn", i}});
    std::exit(LogLinesDropped() > 0 ? 0 : 1);
  }
  int status = 0;
  ASSERT_EQ(waitpid(pid, &status, 0), pid);
  EXPECT_EQ(status, 0);
}

TEST(DaemonLogTest, AForkedChildLogsAndEnds) {
  const Ended ended = RunDaemon([] {
    const pid_t child = fork();
    LogInfo(child == 0 ? "I am the child" : "I am the parent");
    if (child == 0) std::exit(0);
    int status = 0;
    if (waitpid(child, &status, 0) != child || status != 0) std::exit(1);
  });

  EXPECT_TRUE(Exited(ended));
  EXPECT_THAT(ended.log, AllOf(HasSubstr("I am the child\n"), HasSubstr("I am the parent\n")));
}

TEST(DaemonLogTest, WithoutAThreadLinesAreWrittenWhileTheyAreRead) {
  if (geteuid() != 0) GTEST_SKIP() << "needs a user without processes";
  int ends[2];
  ASSERT_EQ(pipe2(ends, O_CLOEXEC), 0);
  const UniqueFd read_end(ends[0]);
  UniqueFd write_end(ends[1]);
  const pid_t pid = fork();
  if (pid == 0) {
    dup2(write_end.get(), STDERR_FILENO);
    write_end.Reset();
    const rlimit one = {.rlim_cur = 1, .rlim_max = 1};
    if (setrlimit(RLIMIT_NPROC, &one) != 0 || setuid(64'123) != 0) _exit(2);
    StartLogWriter();
    LogInfo("working");
    _exit(0);  // a sanitizer would want a thread for the end
  }
  write_end.Reset();
  int status = 0;
  ASSERT_EQ(waitpid(pid, &status, 0), pid);
  EXPECT_EQ(status, 0);
  char text[4'096] = {};
  ASSERT_GT(read(read_end.get(), text, sizeof(text) - 1), 0);
  EXPECT_THAT(text, AllOf(HasSubstr("no thread for the log"), HasSubstr("info working\n")));
}

// Of a process whose standard streams are closed, a file would have got the number of one.
TEST(StandardStreamsTest, ClosedOnesAreOpenedOnTheNullDevice) {
  const pid_t pid = fork();
  if (pid == 0) {
    for (int fd = 0; fd <= 2; ++fd) close(fd);
    eventfd(0, 0);  // as gRPC before main()
    OpenStandardStreams();
    struct stat null = {}, mine = {};
    stat("/dev/null", &null);
    for (int fd = 0; fd <= 2; ++fd) {
      if (fstat(fd, &mine) != 0 || mine.st_rdev != null.st_rdev) _exit(1);
    }
    _exit(open("/", O_RDONLY) > 2 ? 0 : 2);
  }
  int status = 0;
  ASSERT_EQ(waitpid(pid, &status, 0), pid);
  EXPECT_EQ(status, 0);
}

TEST(StandardStreamsTest, OpenOnesStayAsTheyAre) {
  struct stat before = {}, after = {};
  ASSERT_EQ(fstat(STDERR_FILENO, &before), 0);
  OpenStandardStreams();
  ASSERT_EQ(fstat(STDERR_FILENO, &after), 0);
  EXPECT_EQ(before.st_ino, after.st_ino);
}

TEST(LibraryLogTest, ALibraryThatFloodsIsLimitedAndCounted) {
  ::testing::internal::CaptureStderr();
  for (int i = 0; i < 1'000; ++i) {
    LogOfLibrary(LogLevel::kWarning, "library", "message\n", "file.c:7");
  }
  LogOfLibrary(LogLevel::kWarning, "other library", "message", "");
  const std::string log = ::testing::internal::GetCapturedStderr();

  EXPECT_THAT(log, HasSubstr(" warning library text=\"message (file.c:7)\"\n"));
  EXPECT_THAT(log, HasSubstr(" warning other library text=message\n"));
  size_t lines = 0;
  for (const char c : log) lines += c == '\n' ? 1 : 0;
  EXPECT_GE(lines, 21);
  EXPECT_LT(lines, 200);  // a slow machine takes seconds
}

}  // namespace
}  // namespace rips
