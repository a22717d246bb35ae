#include "mode_actuator/exec/posix_runner.h"

#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <fstream>
#include <optional>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

using ::testing::HasSubstr;

constexpr char kBash[] = "/usr/bin/bash";

// Waits for one result.
class Waiter {
 public:
  ProgramRunner::Done Callback() {
    return [this](ProgramResult result) {
      MutexLock lock(&mu_);
      result_ = std::move(result);
      changed_.NotifyAll();
    };
  }
  ProgramResult Wait() {
    MutexLock lock(&mu_);
    for (int i = 0; i < 300 && !result_.has_value(); ++i) {
      changed_.WaitFor(lock, absl::Milliseconds(100));
    }
    EXPECT_TRUE(result_.has_value()) << "no result within 30 s";
    return result_.value_or(ProgramResult{.status = absl::InternalError("none")});
  }

 private:
  Mutex mu_;
  CondVar changed_;
  std::optional<ProgramResult> result_;
};

class PosixRunnerTest : public ::testing::Test {
 protected:
  PosixRunnerTest() {
    runner_ =
        *PosixRunner::Create({{.name = "bash", .path = kBash, .concurrency = 2},
                              {.name = "echo", .path = "/usr/bin/echo", .concurrency = 32},
                              {.name = "quick", .path = kBash, .timeout = absl::Milliseconds(300)},
                              {.name = "gone", .path = "/usr/bin/rips-no-such-program"},
                              {.name = "linked", .path = "/bin/echo"}},
                             &clock_);
  }
  ProgramResult Run(const std::string& name, std::vector<std::string> args,
                    absl::Duration timeout = absl::Seconds(10)) {
    Waiter waiter;
    const auto run = runner_->Start({name, std::move(args), timeout}, waiter.Callback());
    EXPECT_THAT(run, IsOk());
    return run.ok() ? waiter.Wait() : ProgramResult{.status = run.status()};
  }
  ProgramResult Script(const std::string& script, absl::Duration timeout = absl::Seconds(10)) {
    return Run("bash", {"-c", script}, timeout);
  }

  RealClock clock_;
  std::unique_ptr<PosixRunner> runner_;
};

bool Alive(pid_t pid) { return kill(pid, 0) == 0; }

bool EndsSoon(pid_t pid) {
  for (int i = 0; i < 500 && Alive(pid); ++i) usleep(10'000);
  return !Alive(pid);
}

TEST_F(PosixRunnerTest, ReportsOutputAndExitCode) {
  const ProgramResult good = Script("echo out; echo err >&2");
  EXPECT_THAT(good.status, IsOk());
  EXPECT_EQ(good.exit_code, 0);
  EXPECT_EQ(good.output_tail, "out\nerr\n");

  const ProgramResult bad = Script("exit 7");
  EXPECT_THAT(bad.status, StatusIs(absl::StatusCode::kAborted, "exit code 7"));
  EXPECT_EQ(bad.exit_code, 7);

  const ProgramResult killed = Script("kill -9 $$");
  EXPECT_EQ(killed.exit_code, 128 + SIGKILL);
  EXPECT_THAT(killed.status, StatusIs(absl::StatusCode::kAborted, "ended by signal 9"));
}

TEST_F(PosixRunnerTest, ArgumentsAreTakenLiterally) {
  EXPECT_EQ(Run("echo", {"$(id)", "; rm -rf /", "a  b", "`x`"}).output_tail,
            "$(id) ; rm -rf / a  b `x`\n");
}

TEST_F(PosixRunnerTest, InheritsNothing) {
  ASSERT_EQ(setenv("RIPS_SECRET", "hunter2", 1), 0);
  const int open_file = open("/etc/hostname", O_RDONLY);  // no O_CLOEXEC, on purpose
  ASSERT_GE(open_file, 3);
  sigset_t blocked;
  sigemptyset(&blocked);
  sigaddset(&blocked, SIGTERM);
  sigset_t before;
  pthread_sigmask(SIG_BLOCK, &blocked, &before);

  const ProgramResult result = Script(
      "env; pwd; ls /proc/self/fd | tr '\\n' ' '; cat; grep SigBlk /proc/self/status; "
      "ps -o sid= -p $$ 2>/dev/null | tr -d ' ' | grep -qx $$ && echo own session");

  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  close(open_file);
  EXPECT_THAT(result.output_tail, ::testing::Not(HasSubstr("hunter2")));
  EXPECT_THAT(result.output_tail, HasSubstr("PATH=/usr/sbin:/usr/bin\n"));
  EXPECT_THAT(result.output_tail, HasSubstr("\n/\n"));
  EXPECT_THAT(result.output_tail, HasSubstr("0 1 2 3 "));  // 3 is the directory ls reads
  EXPECT_THAT(result.output_tail, ::testing::Not(HasSubstr("0 1 2 3 4")));
  EXPECT_THAT(result.output_tail, HasSubstr("SigBlk:\t0000000000000000"));
}

TEST_F(PosixRunnerTest, KillsWhatHangs) {
  const ProgramResult result = Script("sleep 60", absl::Milliseconds(200));
  EXPECT_THAT(result.status, StatusIs(absl::StatusCode::kDeadlineExceeded, "killed after 200ms"));
  EXPECT_EQ(result.exit_code, 128 + SIGTERM);
  EXPECT_GE(result.took_ms, 200u);
}

TEST_F(PosixRunnerTest, TheProgramsOwnTimeoutIsTheLimit) {
  EXPECT_THAT(Run("quick", {"-c", "sleep 60"}, absl::Seconds(50)).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded, "killed after 300ms"));
}

TEST_F(PosixRunnerTest, KillsWhatIgnoresSigterm) {
  const ProgramResult result =
      Script("trap '' TERM; while true; do sleep 0.05; done", absl::Milliseconds(200));
  EXPECT_THAT(result.status, StatusIs(absl::StatusCode::kDeadlineExceeded));
  EXPECT_EQ(result.exit_code, 128 + SIGKILL);
  EXPECT_GE(result.took_ms, 500u);  // 200 ms and the grace
}

TEST_F(PosixRunnerTest, KillsGrandchildren) {
  for (const char* script : {"sleep 60 & echo $!; exit 0", "sleep 60 & echo $!; wait"}) {
    const ProgramResult result = Script(script, absl::Milliseconds(300));
    int grandchild = 0;
    ASSERT_TRUE(absl::SimpleAtoi(result.output_tail, &grandchild)) << result.output_tail;
    EXPECT_TRUE(EndsSoon(grandchild)) << script;
  }
}

TEST_F(PosixRunnerTest, ADaemonThatKeepsThePipeOpenDoesNotHoldUsUp) {
  const ProgramResult result = Script("setsid sleep 5 & echo $!; exit 0");
  EXPECT_THAT(result.status, IsOk());
  EXPECT_LT(result.took_ms, 4'000u);
}

TEST_F(PosixRunnerTest, AFloodOfOutputIsDrainedAndItsEndKept) {
  const ProgramResult result = Script("head -c 30000000 /dev/zero | tr '\\0' x; echo end");
  EXPECT_THAT(result.status, IsOk());
  EXPECT_EQ(result.output_bytes, 30'000'004u);
  EXPECT_EQ(result.output_tail.size(), kOutputBytesMax);
  EXPECT_TRUE(absl::EndsWith(result.output_tail, "xend\n"));

  EXPECT_THAT(Script("yes", absl::Milliseconds(200)).status,
              StatusIs(absl::StatusCode::kDeadlineExceeded));
}

TEST_F(PosixRunnerTest, CancelEndsIt) {
  Waiter waiter;
  const auto run =
      runner_->Start({"bash", {"-c", "sleep 60"}, absl::Seconds(10)}, waiter.Callback());
  ASSERT_THAT(run, IsOk());
  runner_->Cancel(*run);
  EXPECT_THAT(waiter.Wait().status, StatusIs(absl::StatusCode::kCancelled));
  runner_->Cancel(*run);
  runner_->Cancel(12'345);
}

TEST_F(PosixRunnerTest, ItsEndKillsWhatRuns) {
  Waiter waiter;
  ASSERT_THAT(runner_->Start({"bash", {"-c", "trap '' TERM; sleep 60"}, absl::Seconds(10)},
                             waiter.Callback()),
              IsOk());
  runner_.reset();
  EXPECT_EQ(waiter.Wait().exit_code, 128 + SIGKILL);
}

TEST_F(PosixRunnerTest, RefusesWhatIsNotAllowed) {
  const auto start = [&](const std::string& name, std::vector<std::string> args) {
    return runner_->Start({name, std::move(args), absl::Seconds(1)},
                          [](ProgramResult) { ADD_FAILURE() << "started"; });
  };
  EXPECT_THAT(start("rm", {}), StatusIs(absl::StatusCode::kPermissionDenied,
                                        "program `rm` is not in the allow-list"));
  EXPECT_THAT(start("/usr/bin/bash", {}), StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_THAT(start("", {}), StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_THAT(start("gone", {}), StatusIs(absl::StatusCode::kNotFound, HasSubstr("rips-no-such")));
  EXPECT_THAT(start("linked", {}),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("`/bin` is a symbolic")));
  EXPECT_THAT(start("echo", {std::string("a\0b", 3)}),
              StatusIs(absl::StatusCode::kInvalidArgument, "an argument holds a NUL byte"));
  EXPECT_THAT(start("echo", std::vector<std::string>(kArgsMax + 1)),
              StatusIs(absl::StatusCode::kInvalidArgument, "65 arguments exceed limit 64"));
  EXPECT_THAT(start("echo", {std::string(kArgBytesMax + 1, 'a')}),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST_F(PosixRunnerTest, LimitsWhatRunsAtTheSameTime) {
  std::vector<uint64_t> runs;
  for (int i = 0; i < 2; ++i) {
    const auto run =
        runner_->Start({"bash", {"-c", "sleep 60"}, absl::Seconds(9)}, [](ProgramResult) {});
    ASSERT_THAT(run, IsOk());
    runs.push_back(*run);
  }
  EXPECT_THAT(runner_->Start({"bash", {}, absl::Seconds(1)}, [](ProgramResult) {}),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       "program `bash` runs already, concurrency limit 2"));
  for (uint64_t run : runs) runner_->Cancel(run);
}

TEST_F(PosixRunnerTest, LimitsWhatRunsInAll) {
  auto runner = PosixRunner::Create(
      {{.name = "sleep", .path = "/usr/bin/sleep", .concurrency = 99}}, &clock_);
  ASSERT_THAT(runner, IsOk());
  for (int i = 0; i < kRunsMax; ++i) {
    EXPECT_THAT((*runner)->Start({"sleep", {"60"}, absl::Seconds(9)}, [](ProgramResult) {}),
                IsOk());
  }
  EXPECT_THAT((*runner)->Start({"sleep", {"60"}, absl::Seconds(9)}, [](ProgramResult) {}),
              StatusIs(absl::StatusCode::kResourceExhausted, "running programs exceed limit 16"));
}

// --- the path

class ProgramPathTest : public ::testing::Test {
 protected:
  ProgramPathTest() {
    char name[] = "/tmp/rips-path-XXXXXX";
    dir_ = mkdtemp(name);
    chmod(dir_.c_str(), 0755);
    mkdir((dir_ + "/bin").c_str(), 0755);
    std::ofstream(dir_ + "/bin/run") << "#!/bin/sh\n";
    chmod((dir_ + "/bin").c_str(), 0755);
    chmod((dir_ + "/bin/run").c_str(), 0755);
    root_fd_ = open(dir_.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC);
  }
  ~ProgramPathTest() override {
    close(root_fd_);
    [[maybe_unused]] const int ended = system(("rm -rf " + dir_).c_str());
  }
  absl::Status Check(absl::string_view path = "/bin/run") {
    return CheckProgramPath(root_fd_, path);
  }

  std::string dir_;
  int root_fd_ = -1;
};

TEST_F(ProgramPathTest, FindsEachWayOthersCouldChangeIt) {
  if (geteuid() != 0) GTEST_SKIP() << "making files of root needs root";
  EXPECT_THAT(Check(), IsOk());
  const auto denied = [](const char* why) {
    return StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr(why));
  };
  const std::string run = dir_ + "/bin/run";

  chmod(run.c_str(), 0775);
  EXPECT_THAT(Check(), denied("`/bin/run` can be written by others"));
  chmod(run.c_str(), 0757);
  EXPECT_THAT(Check(), denied("`/bin/run` can be written by others"));
  chmod(run.c_str(), 0644);
  EXPECT_THAT(Check(), denied("`/bin/run` is not executable"));
  chmod(run.c_str(), 0755);
  chmod((dir_ + "/bin").c_str(), 0775);
  EXPECT_THAT(Check(), denied("`/bin` can be written by others"));
  chmod((dir_ + "/bin").c_str(), 01777);
  EXPECT_THAT(Check(), denied("`/bin` can be written by others"));
  chmod((dir_ + "/bin").c_str(), 0755);
  chmod(dir_.c_str(), 0777);
  EXPECT_THAT(Check(), denied("`/` can be written by others"));
  chmod(dir_.c_str(), 0755);
  ASSERT_EQ(chown(run.c_str(), 12'345, 0), 0);
  EXPECT_THAT(Check(), denied("`/bin/run` is not owned by root"));
  ASSERT_EQ(chown(run.c_str(), 0, 0), 0);
  EXPECT_THAT(Check(), IsOk());
}

TEST_F(ProgramPathTest, RefusesLinksAndOddPaths) {
  if (geteuid() != 0) GTEST_SKIP() << "making files of root needs root";
  ASSERT_EQ(symlink("run", (dir_ + "/bin/link").c_str()), 0);
  ASSERT_EQ(symlink("bin", (dir_ + "/sbin").c_str()), 0);
  const auto denied = StatusIs(absl::StatusCode::kPermissionDenied);
  EXPECT_THAT(Check("/bin/link"), denied);
  EXPECT_THAT(Check("/sbin/run"), denied);
  EXPECT_THAT(Check("bin/run"), denied);
  EXPECT_THAT(Check(""), denied);
  EXPECT_THAT(Check("/"), denied);
  EXPECT_THAT(Check("/bin/../bin/run"), denied);
  EXPECT_THAT(Check("/bin/./run"), denied);
  EXPECT_THAT(Check("//bin/run"), denied);
  EXPECT_THAT(Check("/bin/run/"), denied);
  EXPECT_THAT(Check("/bin"), denied);
  EXPECT_THAT(Check("/bin/nothing"), StatusIs(absl::StatusCode::kNotFound));
}

}  // namespace
}  // namespace rips::actuator
