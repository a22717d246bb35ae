#include "policy_server/policy/inspect/child_process.h"

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

  std::string Write(const std::string& text) {
    const std::string path = absl::StrCat(dir_, "/program", ++files_);
    std::ofstream(path) << text;
    EXPECT_EQ(chmod(path.c_str(), 0755), 0);
    return path;
  }
  std::string Shell(const std::string& script) {
    return Write(absl::StrCat("#!/bin/sh\n", script, "\n"));
  }
  static std::unique_ptr<ChildProcess> Start(const std::string& path) {
    auto started =
        ChildProcess::StartPlugin(path, std::filesystem::path(path).parent_path(), {}, {});
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
  const std::string path = Write(
      "#!/usr/bin/python3 -S\n"
      "import os, resource, signal, sys\n"
      "def check(number, good):\n"
      "    if not good: sys.exit(number)\n"
      "check(1, set(os.environ) <= {'PATH', 'LANG', 'LC_CTYPE'})\n"
      "check(2, os.getcwd() == '/')\n"
      "def is_open(fd):\n"
      "    try: os.fstat(fd)\n"
      "    except OSError: return False\n"
      "    return True\n"
      "check(3, [fd for fd in range(64) if is_open(fd)] == [0, 1, 2])\n"
      "check(4, [resource.getrlimit(each)[1] for each in (resource.RLIMIT_NOFILE,\n"
      "          resource.RLIMIT_CORE, resource.RLIMIT_FSIZE)] == [64, 0, 0])\n"
      "check(5, resource.getrlimit(resource.RLIMIT_AS)[1] == 1 << 30)\n"
      "check(7, signal.pthread_sigmask(signal.SIG_BLOCK, []) == set())\n"
      "check(8, signal.getsignal(signal.SIGTERM) == signal.SIG_DFL)\n");

  EXPECT_EQ(StatusOf(*Start(path)), 0) << "the number of the check that failed";
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
