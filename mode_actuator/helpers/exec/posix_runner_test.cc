#include "mode_actuator/helpers/exec/posix_runner.h"

#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <fstream>
#include <optional>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
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
    for (int i = 0; i < 1500 && !result_.has_value(); ++i) {
      changed_.WaitFor(lock, absl::Milliseconds(100));
    }
    EXPECT_TRUE(result_.has_value()) << "no result within 150 s";
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
    MakeRunner({{.name = "bash", .path = kBash, .concurrency = 2},
                {.name = "echo", .path = "/usr/bin/echo", .concurrency = 32},
                {.name = "quick", .path = kBash, .timeout = absl::Milliseconds(300)},
                {.name = "gone", .path = "/usr/bin/rips-no-such-program"},
                {.name = "linked", .path = "/bin/echo"}});
  }
  void MakeRunner(std::vector<ProgramSpec> allowed) {
    runner_ = std::make_unique<PosixRunner>(PosixRunnerOptions{.allowed = std::move(allowed),
                                                               .robot = "r1",
                                                               .host = "base",
                                                               .enter = RIPS_BIN_DIR "/rips-exec",
                                                               .cgroups = cgroups()},
                                            &clock_);
  }
  virtual RunCgroups* cgroups() { return nullptr; }
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
      Script("trap '' TERM; while true; do sleep 0.05; done", absl::Seconds(2));
  EXPECT_THAT(result.status, StatusIs(absl::StatusCode::kDeadlineExceeded));
  EXPECT_EQ(result.exit_code, 128 + SIGKILL);
  EXPECT_GE(result.took_ms, 2'300u);  // 2 s and the grace
}

TEST_F(PosixRunnerTest, KillsGrandchildren) {
  for (const char* script : {"sleep 60 & echo $!; exit 0", "sleep 60 & echo $!; wait"}) {
    const ProgramResult result = Script(script, absl::Seconds(2));
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

// --- with cgroups

class CgroupRunnerTest : public PosixRunnerTest {
 protected:
  void SetUp() override {
    int left_behind = 0;
    auto cgroups = RunCgroups::Open("", Key(), &left_behind);
    if (!cgroups.ok()) {
      GTEST_SKIP() << "cgroup v2 needs root and a mount of it: " << cgroups.status();
    }
    cgroups_ = *std::move(cgroups);
    MakeRunner({{.name = "bash", .path = kBash, .concurrency = 2}});
  }
  void TearDown() override {
    runner_.reset();
    cgroups_.reset();
  }
  static std::string Key() { return absl::StrCat("rips-exec-test-", getpid()); }
  RunCgroups* cgroups() override { return cgroups_.get(); }

  std::unique_ptr<RunCgroups> cgroups_;
};

TEST_F(CgroupRunnerTest, ADaemonIsKilledWithItsRunAndTold) {
  const ProgramResult result = Script("setsid sleep 60 >&- 2>&- & echo $!; exit 0");
  EXPECT_THAT(result.status, IsOk());
  EXPECT_EQ(result.note, "left 1 process behind, killed");
  int daemon = 0;
  ASSERT_TRUE(absl::SimpleAtoi(result.output_tail, &daemon)) << result.output_tail;
  EXPECT_TRUE(EndsSoon(daemon));
}

TEST_F(CgroupRunnerTest, ADaemonIsKilledAtTheDeadlineAndByCancel) {
  const std::string script =
      "setsid bash -c \"trap '' TERM; while true; do sleep 1; done\" & "
      "echo $!; trap '' TERM; while true; do sleep 1; done";
  const ProgramResult late = Script(script, absl::Seconds(2));
  EXPECT_THAT(late.status, StatusIs(absl::StatusCode::kDeadlineExceeded));
  int daemon = 0;
  ASSERT_TRUE(absl::SimpleAtoi(late.output_tail, &daemon)) << late.output_tail;
  EXPECT_TRUE(EndsSoon(daemon));

  const std::string file = absl::StrCat("/tmp/rips-daemon-", getpid());
  Waiter waiter;
  const auto run = runner_->Start(
      {"bash", {"-c", "setsid sleep 60 & echo $! > " + file + "; wait"}, absl::Seconds(30)},
      waiter.Callback());
  ASSERT_THAT(run, IsOk());
  for (int i = 0; i < 1000 && daemon != 0; ++i) {
    std::ifstream(file) >> daemon;
    if (daemon != 0 && Alive(daemon)) break;
    usleep(10'000);
  }
  runner_->Cancel(*run);
  EXPECT_THAT(waiter.Wait().status, StatusIs(absl::StatusCode::kCancelled));
  EXPECT_TRUE(EndsSoon(daemon));
  unlink(file.c_str());
}

TEST_F(CgroupRunnerTest, TwoHundredChildrenAreKilled) {
  const ProgramResult result =
      Script("for i in $(seq 200); do setsid sleep 60 & done; echo done; exit 3");
  EXPECT_THAT(result.status, StatusIs(absl::StatusCode::kAborted, "exit code 3"));
  EXPECT_EQ(result.note, "left 200 processes behind, killed");
}

TEST_F(CgroupRunnerTest, ItsEndKillsDaemonsToo) {
  Waiter waiter;
  ASSERT_THAT(runner_->Start({"bash", {"-c", "setsid sleep 60 & wait"}, absl::Seconds(30)},
                             waiter.Callback()),
              IsOk());
  runner_.reset();
  EXPECT_EQ(waiter.Wait().exit_code, 128 + SIGKILL);
  // Empty: it can be removed, and nothing is found there by the next one.
  const std::string path = cgroups_->path();
  cgroups_.reset();
  EXPECT_NE(access(path.c_str(), F_OK), 0);
}

TEST_F(CgroupRunnerTest, WhatAPredecessorLeftIsKilled) {
  auto run = cgroups_->Make();
  ASSERT_THAT(run, IsOk());
  const auto procs = (*run)->OpenProcs();
  ASSERT_THAT(procs, IsOk());
  Waiter waiter;
  const auto sleeper = runner_->Start(
      {"bash", {"-c", "echo 0 > /dev/null; sleep 60"}, absl::Seconds(30)}, waiter.Callback());
  ASSERT_THAT(sleeper, IsOk());

  int left_behind = 0;
  const auto next = RunCgroups::Open("", Key(), &left_behind);
  ASSERT_THAT(next, IsOk());
  EXPECT_GE(left_behind, 1);
  EXPECT_EQ(waiter.Wait().exit_code, 128 + SIGKILL);
}

TEST(RunCgroupsTest, FindsTheOwnCgroup) {
  const std::string unified =
      "30 24 0:26 / /sys/fs/cgroup rw,nosuid shared:9 - cgroup2 cgroup2 rw\n";
  EXPECT_EQ(*FindCgroup(unified, "0::/system.slice/rips-exec.service\n"),
            "/sys/fs/cgroup/system.slice/rips-exec.service");
  const std::string hybrid =
      "24 22 0:21 / /sys/fs/cgroup rw - tmpfs tmpfs rw\n"
      "25 24 0:22 / /sys/fs/cgroup/cpu rw - cgroup cgroup rw,cpu\n"
      "33 24 0:30 / /sys/fs/cgroup/uni\\040fied rw - cgroup2 cgroup2 rw\n";
  EXPECT_EQ(*FindCgroup(hybrid, "9:name=systemd:/\n0::/\n"), "/sys/fs/cgroup/uni fied");
  const std::string part = "30 24 0:26 /docker/1 /sys/fs/cgroup rw - cgroup2 cgroup2 rw\n";
  EXPECT_EQ(*FindCgroup(part, "0::/docker/1/x\n"), "/sys/fs/cgroup/x");
  EXPECT_EQ(*FindCgroup(part, "0::/docker/1\n"), "/sys/fs/cgroup");
  EXPECT_THAT(FindCgroup(part, "0::/docker/12\n"), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(FindCgroup(hybrid, "9:name=systemd:/\n"), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(FindCgroup("", "0::/\n"), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(FindCgroup("cgroup2\n - cgroup2 \n", "0::nothing\n"),
              StatusIs(absl::StatusCode::kNotFound));
}

TEST(RunCgroupsTest, APlaceThatIsNoneIsTold) {
  int left_behind = 0;
  char name[] = "/tmp/rips-cgroup-XXXXXX";
  const std::string directory = mkdtemp(name);
  EXPECT_THAT(RunCgroups::Open(directory, "x", &left_behind),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("is it cgroup v2")));
  EXPECT_EQ(rmdir(directory.c_str()), 0) << "something was left there";
  EXPECT_THAT(RunCgroups::Open(directory, "x", &left_behind),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("cannot make a cgroup")));
}

// --- what they are told, and what is checked

TEST_F(PosixRunnerTest, TheEnvironmentIsTheirsAlone) {
  MakeRunner({{.name = "env", .path = "/usr/bin/env", .drill = true},
              {.name = "true", .path = "/usr/bin/true"}});
  EXPECT_EQ(Run("env", {}).output_tail,
            "PATH=/usr/sbin:/usr/bin\nLANG=C.UTF-8\nRIPS_ROBOT=r1\nRIPS_HOST=base\n");
  Waiter waiter;
  ProgramRequest request = {.name = "env", .timeout = absl::Seconds(10), .drill = true};
  request.level_from = "DEFAULT";
  request.level_to = "ALERT";
  ASSERT_THAT(runner_->Start(request, waiter.Callback()), IsOk());
  EXPECT_THAT(waiter.Wait().output_tail,
              HasSubstr("RIPS_LEVEL_FROM=DEFAULT\nRIPS_LEVEL_TO=ALERT\nRIPS_DRILL=1\n"));
  request.name = "true";
  EXPECT_THAT(
      runner_->Start(request, [](ProgramResult) {}),
      StatusIs(absl::StatusCode::kPermissionDenied, "program `true` may not be run as a drill"));
}

TEST_F(PosixRunnerTest, DumpsNoCore) { EXPECT_EQ(Script("ulimit -c").output_tail, "0\n"); }

TEST_F(PosixRunnerTest, StartsPerMinuteAreLimited) {
  MakeRunner({{.name = "true", .path = "/usr/bin/true", .starts_per_minute = 2}});
  EXPECT_THAT(Run("true", {}).status, IsOk());
  EXPECT_THAT(Run("true", {}).status, IsOk());
  EXPECT_THAT(runner_->Start({"true", {}, absl::Seconds(1)}, [](ProgramResult) {}),
              StatusIs(absl::StatusCode::kResourceExhausted,
                       "program `true` was started 2 times within a minute, rate limit 2/min"));
}

class ScriptFileTest : public PosixRunnerTest {
 protected:
  void SetUp() override {
    if (geteuid() != 0) GTEST_SKIP() << "making programs of root needs root";
    // Every directory on the way must be root's alone, which /tmp is not.
    char name[] = "/opt/rips-runner-XXXXXX";
    ASSERT_NE(mkdtemp(name), nullptr);
    directory_ = name;
    chmod(name, 0755);
  }
  void TearDown() override {
    runner_.reset();
    if (directory_.empty()) return;
    [[maybe_unused]] const int ended = system(("rm -rf " + directory_).c_str());
  }
  void Write(const std::string& text, const std::string& sha256 = "") {
    std::ofstream(directory_ + "/run") << text;
    chmod((directory_ + "/run").c_str(), 0755);
    MakeRunner({{.name = "run", .path = directory_ + "/run", .sha256 = sha256}});
  }

  std::string directory_;
};

TEST_F(ScriptFileTest, AScriptRunsAndIsCalledByItsDescriptor) {
  Write("#!/bin/sh\necho \"$0 $1\"\n");
  EXPECT_EQ(Run("run", {"a b"}).output_tail, "/dev/fd/3 a b\n");
}

TEST_F(ScriptFileTest, WhatCannotBeExecutedIsTold) {
  const auto start = [&] {
    return runner_->Start({"run", {}, absl::Seconds(1)}, [](ProgramResult) {}).status();
  };
  Write("#!/no/such/interpreter\n");
  EXPECT_THAT(start(), StatusIs(absl::StatusCode::kUnavailable,
                                HasSubstr("/run`: cannot be executed: No such file")));
  Write("no program\n");
  EXPECT_THAT(start(), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("Exec format error")));
  Write("");
  EXPECT_THAT(start(), StatusIs(absl::StatusCode::kUnavailable, HasSubstr("Exec format error")));
  EXPECT_THAT(runner_->Examine("run"), IsOk()) << "it only looks at the file";
}

TEST_F(ScriptFileTest, AFileWithAnotherSha256IsNotRun) {
  // sha256sum of `#!/bin/sh` and a line feed.
  const std::string sha256 = "a8076d3d28d21e02012b20eaf7dbf75409a6277134439025f282e368e3305abf";
  Write("#!/bin/sh\n", sha256);
  EXPECT_THAT(Run("run", {}).status, IsOk());
  EXPECT_THAT(runner_->Examine("run"), IsOk());
  std::ofstream(directory_ + "/run", std::ios::app) << "# changed\n";
  EXPECT_THAT(runner_->Examine("run"),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("the file's SHA-256 is ")));
  EXPECT_THAT(runner_->Start({"run", {}, absl::Seconds(1)}, [](ProgramResult) {}),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("/run`: the file's")));
}

TEST_F(PosixRunnerTest, AGigabyteOfOutputIsDrained) {
  MakeRunner({{.name = "bash", .path = kBash, .timeout = absl::Minutes(10)}});
  const ProgramResult result =
      Script("head -c 1073741824 /dev/zero", /*timeout=*/absl::Minutes(10));
  EXPECT_THAT(result.status, IsOk());
  EXPECT_EQ(result.output_bytes, 1u << 30);
  EXPECT_EQ(result.output_tail.size(), kOutputBytesMax);
}

TEST_F(PosixRunnerTest, ManyAndLongArgumentsArrive) {
  MakeRunner({{.name = "wc", .path = kBash}});
  std::vector<std::string> args = {"-c", "echo $# ${#1} ${#61}", "bash"};
  args.resize(kArgsMax, std::string(kArgBytesMax, 'a'));
  EXPECT_EQ(Run("wc", args).output_tail, "61 4096 4096\n");
}

TEST_F(PosixRunnerTest, ExaminesWithoutRunning) {
  EXPECT_THAT(runner_->Examine("bash"), IsOk());
  EXPECT_THAT(runner_->Examine("gone"), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_THAT(runner_->Examine("linked"), StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_THAT(runner_->Examine("rm"), StatusIs(absl::StatusCode::kPermissionDenied));
  EXPECT_THAT(runner_->Examine(absl::string_view("bash\0x", 6)),
              StatusIs(absl::StatusCode::kPermissionDenied));
}

TEST_F(PosixRunnerTest, WithoutRipsExecNothingStarts) {
  runner_ = std::make_unique<PosixRunner>(
      PosixRunnerOptions{.allowed = {{.name = "true", .path = "/usr/bin/true"}},
                         .enter = "/usr/lib/rips/no-such-rips-exec"},
      &clock_);
  EXPECT_THAT(runner_->Start({"true", {}, absl::Seconds(1)}, [](ProgramResult) {}),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("cannot start")));

  // One that ends, and one that hangs, before it becomes the program.
  for (const auto& [text, why] :
       {std::pair("exit 0", "rips-exec ended before it became the program"),
        std::pair("sleep 60", "it did not start within 2s")}) {
    char name[] = "/tmp/rips-enter-XXXXXX";
    const int fd = mkstemp(name);
    ASSERT_GE(fd, 0);
    fchmod(fd, 0700);
    close(fd);
    std::ofstream(name) << "#!/bin/sh\n" << text << "\n";
    runner_ = std::make_unique<PosixRunner>(
        PosixRunnerOptions{.allowed = {{.name = "true", .path = "/usr/bin/true"}}, .enter = name},
        &clock_);
    EXPECT_THAT(runner_->Start({"true", {}, absl::Seconds(1)}, [](ProgramResult) {}),
                StatusIs(absl::StatusCode::kUnavailable, HasSubstr(why)));
    unlink(name);
  }
}

// --- refusals

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
  MakeRunner({{.name = "sleep", .path = "/usr/bin/sleep", .concurrency = 99}});
  for (int i = 0; i < kRunsMax; ++i) {
    EXPECT_THAT(runner_->Start({"sleep", {"60"}, absl::Seconds(9)}, [](ProgramResult) {}), IsOk());
  }
  EXPECT_THAT(runner_->Start({"sleep", {"60"}, absl::Seconds(9)}, [](ProgramResult) {}),
              StatusIs(absl::StatusCode::kResourceExhausted, "running programs exceed limit 16"));
}

}  // namespace
}  // namespace rips::actuator
