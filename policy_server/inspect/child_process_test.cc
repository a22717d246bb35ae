#include "policy_server/inspect/child_process.h"

#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <thread>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/runtime/real_clock.h"

namespace rips::inspect {
namespace {

class ChildProcessTest : public ::testing::Test {
 protected:
  ChildProcessTest() {
    std::string name = ::testing::TempDir() + "/childXXXXXX";
    dir_ = mkdtemp(name.data());
  }
  ~ChildProcessTest() override { std::filesystem::remove_all(dir_); }

  std::string Shell(const std::string& script) {
    const std::string path = absl::StrCat(dir_, "/program", ++files_);
    std::ofstream(path) << "#!/bin/sh\n" << script << "\n";
    EXPECT_EQ(chmod(path.c_str(), 0755), 0);
    return path;
  }
  static std::unique_ptr<ChildProcess> Start(const std::string& path) {
    auto started = ChildProcess::Start(path, {});
    EXPECT_TRUE(started.ok()) << started.status();
    return started.ok() ? *std::move(started) : nullptr;
  }
  // Waits for its end.
  int StatusOf(ChildProcess& process) const {
    const int64_t deadline_ns = BoottimeAfter(absl::Seconds(60));
    while (!process.Exited() && process.Wait(false, deadline_ns, clock_)) {
    }
    EXPECT_TRUE(process.Exited().has_value());
    return process.Exited().value_or(ChildProcess::Exit{.status = -2}).status;
  }
  // What is shown of what a script writes to its standard error.
  std::string ErrorsOf(const std::string& script) {
    const std::unique_ptr<ChildProcess> process = Start(Shell(absl::StrCat("exec >&2; ", script)));
    EXPECT_EQ(StatusOf(*process), 0);
    return process->Errors();
  }

  RealClock clock_;
  std::string dir_;
  int files_ = 0;
};

TEST_F(ChildProcessTest, InheritsNothing) {
  ASSERT_EQ(setenv("RIPS_SECRET", "hunter2", 1), 0);
  const int open_file = open("/etc/hostname", O_RDONLY);  // no O_CLOEXEC, on purpose
  signal(SIGPIPE, SIG_IGN);
  const std::string path = Shell(
      // First, and without a process of its own: the shell itself blocks signals while it starts one.
      "while read name mask && test \"$name\" != SigBlk:; do :; done </proc/$$/status\n"
      "test \"$mask\" = 0000000000000000 || exit 7\n"
      "test \"$(env | grep -v -e ^PATH= -e ^LANG=C.UTF-8 -e ^PWD= -e ^_= | wc -l)\" = 0 || exit 1\n"
      "test \"$(pwd)\" = / || exit 2\n"
      "ls -l /proc/$$/fd | grep -q -e hostname -e socket -e event && exit 3\n"
      "test \"$(ulimit -n) $(ulimit -c) $(ulimit -f)\" = '64 0 0' || exit 4\n"
      "test \"$(ulimit -v)\" = 1048576 || exit 5\n"
      "grep -q 'NoNewPrivs:.*1' /proc/$$/status || exit 6\n"
      "grep -q 'SigIgn:.*0000000000000000' /proc/$$/status || exit 8\n"
      "readlink /proc/$$/fd/2 | grep -q ^pipe: || exit 9\n"
      "test \"$(cut -d' ' -f5,6 /proc/$$/stat)\" = \"$$ $$\" || exit 10\n"
      "exit 0");

  EXPECT_EQ(StatusOf(*Start(path)), 0) << "the number of the line that failed";
  signal(SIGPIPE, SIG_DFL);
  close(open_file);
}

TEST_F(ChildProcessTest, ProcessesEndWithTheThreadThatStartedThem) {
  std::unique_ptr<ChildProcess> process;
  const std::string path = Shell("exec cat");
  std::thread([&] { process = Start(path); }).join();
  EXPECT_EQ(StatusOf(*process), -1);
}

TEST_F(ChildProcessTest, ShowsTheFirstAndTheLastErrorLine) {
  EXPECT_EQ(ErrorsOf("true"), "");
  EXPECT_EQ(ErrorsOf("printf one"), "one");
  EXPECT_EQ(ErrorsOf("echo one"), "one");
  EXPECT_EQ(ErrorsOf("printf '\\n  one\\r\\n\\n\\ttwo\\nthree\\n\\n'"), "one ... three");
  EXPECT_EQ(ErrorsOf("echo same; echo same"), "same");
  EXPECT_EQ(ErrorsOf("printf '\\n \\n'"), "(blank)");
  EXPECT_EQ(ErrorsOf("printf 'a\\033[2J\\200\\tb'"), "a?[2J??b");
}

TEST_F(ChildProcessTest, ErrorsAreCutAndNeverBlock) {
  const std::string longest(kErrorLineBytesMax, 'x');
  EXPECT_EQ(ErrorsOf(absl::StrCat("printf ", longest)), longest);
  EXPECT_EQ(ErrorsOf(absl::StrCat("printf %s y", longest)),
            absl::StrCat("y", longest.substr(1), " ... ", longest));
  EXPECT_EQ(ErrorsOf("echo first; head -c 1000000 /dev/zero; echo; echo last"), "first ... last");
}

}  // namespace
}  // namespace rips::inspect
