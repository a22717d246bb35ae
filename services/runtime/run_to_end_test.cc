#include "services/runtime/run_to_end.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <string>
#include <vector>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/runtime/unique_fd.h"
#include "services/runtime/wake_fd.h"

namespace rips {
namespace {

using ::testing::HasSubstr;

ProgramCall Shell(const std::string& script, absl::Duration timeout = absl::Seconds(60)) {
  return {.words = {"/bin/sh", "-c", script}, .environment = {}, .input = "", .timeout = timeout};
}

// No child of ours is left, running or unreaped.
bool NoChildren() { return waitpid(-1, nullptr, WNOHANG) == -1 && errno == ECHILD; }

TEST(RunToEndTest, GivesInputAndReturnsBothOutputsAndTheExitCode) {
  ProgramCall call = Shell("cat; echo \"$ONE $HOME $PWD\" >&2; exit 7");
  call.environment = {"ONE=1"};
  call.input = std::string(30'000, 'x');
  const auto end = RunToEnd(call);
  ASSERT_THAT(end, IsOk());
  EXPECT_EQ(end->exit_code, 7);
  EXPECT_EQ(end->out, call.input);
  EXPECT_EQ(end->err, "1  /\n") << "no variable of ours; directory /";
  EXPECT_TRUE(NoChildren());
}

TEST(RunToEndTest, TheProgramHasNoDescriptorSignalOrSessionOfOurs) {
  // Deliberately without close-on-exec.
  const UniqueFd ours(open("/dev/null", O_RDONLY));
  ASSERT_GE(ours.get(), 0);
  sigset_t some, before;
  sigemptyset(&some);
  sigaddset(&some, SIGUSR1);
  pthread_sigmask(SIG_BLOCK, &some, &before);
  // The shell itself blocks signals while it waits; what it starts does not.
  const auto end =
      RunToEnd(Shell("for n in 3 4 5 6 7 8 9; do [ -e /proc/$$/fd/$n ] && echo $n; "
                     "done; [ $(cut -d' ' -f6 /proc/$$/stat) = $$ ] || echo session; "
                     "grep -q 'SigBlk:.0*$' /proc/self/status || echo blocked"));
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
  ASSERT_THAT(end, IsOk());
  EXPECT_EQ(end->out, "");
}

TEST(RunToEndTest, WhatItStartedEndsWithIt) {
  // The background process keeps both outputs open.
  const auto end = RunToEnd(Shell("sleep 600 & echo $!"));
  ASSERT_THAT(end, IsOk()) << "its end counts, not that of its outputs";
  int pid = 0;
  ASSERT_TRUE(absl::SimpleAtoi(end->out, &pid));
  // Killed; who inherits it reaps it.
  while (kill(pid, 0) == 0) {
    const auto state = RunToEnd(Shell("cut -d' ' -f3 /proc/" + std::to_string(pid) + "/stat"));
    if (!state.ok() || state->out != "S\n") break;
  }
  EXPECT_TRUE(NoChildren());
}

TEST(RunToEndTest, OneThatHangsIsKilledWithItsGroup) {
  for (const char* script : {"exec sleep 600", "exec >&- 2>&- sleep 600",
                             "trap '' TERM INT HUP; sleep 600 & wait; sleep 600"}) {
    EXPECT_THAT(RunToEnd(Shell(script, absl::Milliseconds(200))),
                StatusIs(absl::StatusCode::kDeadlineExceeded, HasSubstr("within 200ms")))
        << script;
    EXPECT_TRUE(NoChildren());
  }
}

TEST(RunToEndTest, OneThatPrintsWithoutEndIsKilled) {
  for (const char* script : {"exec cat /dev/zero", "exec cat /dev/zero >&2"}) {
    EXPECT_THAT(RunToEnd(Shell(script)),
                StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("65536 bytes")));
    EXPECT_TRUE(NoChildren());
  }
  const auto full = RunToEnd(Shell("head -c 65536 /dev/zero"));
  ASSERT_THAT(full, IsOk());
  EXPECT_EQ(full->out.size(), 65'536u);
  EXPECT_THAT(RunToEnd(Shell("head -c 65537 /dev/zero")),
              StatusIs(absl::StatusCode::kResourceExhausted));
}

TEST(RunToEndTest, IsGivenUpWhenAsked) {
  const WakeFd wake;
  wake.Wake();
  ProgramCall call = Shell("exec sleep 600");
  call.cancel_fd = wake.get();
  EXPECT_THAT(RunToEnd(call), StatusIs(absl::StatusCode::kCancelled)) << "not even started";
  int ends[2];
  ASSERT_EQ(pipe2(ends, O_CLOEXEC | O_NONBLOCK), 0);
  const UniqueFd cancel(ends[0]);
  const UniqueFd write_end(ends[1]);
  // The program itself asks for its end, through /proc: it has none of our descriptors.
  call = Shell(absl::StrCat("echo x > /proc/", getpid(), "/fd/", ends[1], "; exec sleep 600"));
  call.cancel_fd = cancel.get();
  EXPECT_THAT(RunToEnd(call), StatusIs(absl::StatusCode::kCancelled, HasSubstr("given up")));
  EXPECT_TRUE(NoChildren());
}

TEST(RunToEndTest, SaysWhyAProgramCannotBeStartedAndWhatSignalEndedIt) {
  ProgramCall call = Shell("");
  call.words = {"/nowhere/program"};
  EXPECT_THAT(RunToEnd(call),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("No such file or directory")));
  const auto end = RunToEnd(Shell("kill -9 $$"));
  ASSERT_THAT(end, IsOk());
  EXPECT_EQ(end->exit_code, 128 + SIGKILL);
}

}  // namespace
}  // namespace rips
