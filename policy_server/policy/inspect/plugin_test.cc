#include "policy_server/policy/inspect/plugin.h"

#include <signal.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips::inspect {
namespace {

using engine::Verdict;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

// A framed plugin in Python; `answer` is a function body with `header` and `payload`.
std::string Framed(const std::string& answer) {
  return absl::StrCat(
      "#!/usr/bin/python3 -S\n"
      "import json, os, signal, struct, sys, time\n"
      "def say(text):\n"
      "    os.write(1, text.encode())\n"
      "def judge(header, payload):\n",
      answer,
      "say('rips-plugin 1\\n')\n"
      "asked = 0\n"
      "while True:\n"
      "    size = sys.stdin.buffer.read(4)\n"
      "    if len(size) < 4: sys.exit(200)\n"
      "    header = json.loads(sys.stdin.buffer.read(struct.unpack('<I', size)[0]))\n"
      "    payload = sys.stdin.buffer.read(header['payload_bytes'])\n"
      "    asked += 1\n"
      "    judge(header, payload)\n");
}

// Answers yes to payloads that begin with `bad`.
constexpr char kJudge[] = "    say('1\\n' if payload.startswith(b'bad') else '0\\n')\n";

bool Alive(pid_t pid) { return kill(pid, 0) == 0; }

class PluginTest : public ::testing::Test {
 protected:
  PluginTest() {
    std::string name = ::testing::TempDir() + "/pluginXXXXXX";
    dir_ = mkdtemp(name.data());
  }
  ~PluginTest() override { std::filesystem::remove_all(dir_); }

  // An executable file.
  std::string Write(const std::string& name, const std::string& text, mode_t mode = 0755) {
    const std::string path = dir_ + "/" + name;
    std::ofstream(path) << text;
    EXPECT_EQ(chmod(path.c_str(), mode), 0);
    return path;
  }
  std::string Shell(const std::string& script) {
    return Write(absl::StrCat("plugin", ++files_), "#!/bin/sh\n" + script + "\n");
  }
  // Patient, and never in back-off: what is tested does not depend on how fast this machine is.
  static PluginOptions Patient() {
    return {.answer_time = absl::Seconds(60),
            .greeting_time = absl::Seconds(60),
            .restart = {.first = absl::ZeroDuration(), .longest = absl::ZeroDuration()}};
  }
  static PluginOptions Hasty() {
    PluginOptions options = Patient();
    options.answer_time = absl::Milliseconds(50);
    return options;
  }
  Plugin OneShot(const std::string& script, PluginOptions options = Patient()) {
    return Plugin({"p", Shell(script), PluginProtocol::kOneShot}, options, &clock_);
  }
  Plugin Kept(const std::string& answer, PluginOptions options = Patient()) {
    const std::string path = Write(absl::StrCat("plugin", ++files_), Framed(answer));
    return Plugin({"p", path, PluginProtocol::kFramed}, options, &clock_);
  }
  static Message With(absl::string_view payload, absl::string_view robot = "r1") {
    return {.robot = robot,
            .topic = "/camera",
            .type = "sensor_msgs/msg/Image",
            .sender = "/eye",
            .writer_hex = "01104a3b",
            .time_unix_ns = 1'767'225'600'000'000'007,
            .payload = payload,
            .size_bytes = static_cast<uint32_t>(payload.size()),
            .available = true};
  }

  RealClock clock_;
  std::string dir_;
  int files_ = 0;
};

TEST_F(PluginTest, OneShotAnswersByItsExitStatus) {
  EXPECT_EQ(OneShot("exit 0").Ask(With("x")), Verdict::kYes);
  EXPECT_EQ(OneShot("exit 1").Ask(With("x")), Verdict::kNo);
  EXPECT_EQ(OneShot("exit 125").Ask(With("x")), Verdict::kNo);
  for (const char* status : {"126", "127", "128", "255"}) {
    EXPECT_EQ(OneShot(absl::StrCat("exit ", status)).Ask(With("x")), Verdict::kUnscanned) << status;
  }
  EXPECT_EQ(OneShot("kill -SEGV $$").Ask(With("x")), Verdict::kUnscanned);
  EXPECT_EQ(OneShot("kill -KILL $$").Ask(With("x")), Verdict::kUnscanned);
}

TEST_F(PluginTest, OneShotThatSaysNoAndComplainsHasCrashed) {
  EXPECT_EQ(OneShot("echo note >&2; exit 0").Ask(With("x")), Verdict::kYes);
  EXPECT_EQ(OneShot("echo note >&2; exit 1").Ask(With("x")), Verdict::kUnscanned);
  EXPECT_EQ(OneShot("echo >&2; exit 125").Ask(With("x")), Verdict::kUnscanned);
  EXPECT_EQ(OneShot("exec 2>/dev/null; echo note >&2; exit 1").Ask(With("x")), Verdict::kNo);
  EXPECT_EQ(OneShot("no-such-filter | grep -q x").Ask(With("x")), Verdict::kUnscanned);
  Plugin missing_module({"p", Write("crash", "#!/usr/bin/python3 -S\nimport no_such_module\n")},
                        Patient(), &clock_);

  ::testing::internal::CaptureStderr();
  EXPECT_EQ(missing_module.Ask(With("x")), Verdict::kUnscanned);

  EXPECT_THAT(::testing::internal::GetCapturedStderr(),
              HasSubstr("why=\"exit status 1: Traceback (most recent call last): ... "
                        "ModuleNotFoundError: No module named 'no_such_module'\""));
}

TEST_F(PluginTest, OneShotReadsThePayloadAndItsEnd) {
  Plugin plugin = OneShot("test \"$(wc -c)\" -eq 4194304");
  const std::string large(kPluginPayloadBytesMax, 'x');

  EXPECT_EQ(plugin.Ask(With(large)), Verdict::kYes);
  EXPECT_EQ(plugin.Ask(With("")), Verdict::kNo);
  EXPECT_EQ(plugin.Ask(With("x")), Verdict::kNo);
  EXPECT_EQ(plugin.Ask(With(large + "x")), Verdict::kUnscanned) << "over the limit";
  EXPECT_EQ(plugin.starts(), 3u);
}

TEST_F(PluginTest, OneShotNeedNotReadThePayload) {
  const std::string large(kPluginPayloadBytesMax, 'x');
  EXPECT_EQ(OneShot("exit 0").Ask(With(large)), Verdict::kYes);
  EXPECT_EQ(OneShot("exec 0<&-; exit 3").Ask(With(large)), Verdict::kNo);
}

TEST_F(PluginTest, OneShotInTimeOrUnscanned) {
  Plugin plugin = OneShot("sleep 1000", Hasty());
  EXPECT_EQ(plugin.Ask(With("x")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.failures(), 1u);
}

TEST_F(PluginTest, OneShotThatIsLateAgainAndAgainWaitsAsAFramedOne) {
  PluginOptions options = Hasty();
  options.restart = {.first = absl::Hours(1), .longest = absl::Hours(1)};
  Plugin plugin = OneShot("sleep 1000", options);
  for (int i = 0; i < 100; ++i) EXPECT_EQ(plugin.Ask(With("x")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.starts(), static_cast<uint64_t>(kPluginLateMax));
  EXPECT_EQ(plugin.Ask(With("x", "r2")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.starts(), kPluginLateMax + 1u) << "another robot does not wait";
}

TEST_F(PluginTest, OneShotThatCrashesIsAskedAgain) {
  PluginOptions options = Patient();
  options.restart = {.first = absl::Hours(1), .longest = absl::Hours(1)};
  Plugin plugin = OneShot("kill -9 $$", options);
  for (int i = 0; i < 5; ++i) EXPECT_EQ(plugin.Ask(With("x")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.starts(), 5u);
}

TEST_F(PluginTest, WhatAPluginStartsEndsWithIt) {
  // By its name: it can tell nobody its number. It holds standard output open.
  const std::string name = absl::StrCat("idle", getpid());
  std::filesystem::copy("/usr/bin/sleep", dir_ + "/" + name);
  const auto running = [&name] {
    for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
      std::ifstream stat(entry.path() / "stat");
      std::string line;
      std::getline(stat, line);
      if (absl::StrContains(line, absl::StrCat("(", name, ") ")) &&
          !absl::StrContains(line, ") Z ")) {
        return true;
      }
    }
    return false;
  };
  Plugin plugin = OneShot(absl::StrCat(dir_, "/", name, " 1000 & exit 0"));

  EXPECT_EQ(plugin.Ask(With("x")), Verdict::kYes);

  for (int i = 0; i < 3000 && running(); ++i) usleep(10'000);
  EXPECT_FALSE(running());
}

TEST_F(PluginTest, AFloodOfOutputIsCut) {
  EXPECT_EQ(OneShot("exec head -c 1073741824 /dev/zero").Ask(With("x")), Verdict::kUnscanned);
  EXPECT_EQ(OneShot("head -c 4095 /dev/zero").Ask(With("x")), Verdict::kYes);
  Plugin kept = Kept("    for i in range(1 << 20): say('0' * 1024)\n");
  EXPECT_EQ(kept.Ask(With("x")), Verdict::kUnscanned);
  EXPECT_EQ(kept.failures(), 1u);
}

TEST_F(PluginTest, FilesThatCannotBeExecutedAreUnscannedAndWait) {
  PluginOptions slow_to_retry = Patient();
  slow_to_retry.restart = {.first = absl::Hours(1), .longest = absl::Hours(1)};
  for (const std::string& path :
       {dir_ + "/none", Write("text", "no program", 0755), Write("plain", "#!/bin/sh\n", 0644),
        dir_, Write("lost", "#!/no/such/interpreter\n")}) {
    Plugin plugin({"p", path, PluginProtocol::kOneShot}, slow_to_retry, &clock_);
    EXPECT_EQ(plugin.Ask(With("x")), Verdict::kUnscanned) << path;
    EXPECT_EQ(plugin.Ask(With("x", "r2")), Verdict::kUnscanned) << path;
    EXPECT_EQ(plugin.starts(), 1u) << path;
  }
}

TEST_F(PluginTest, ADyingReaderRaisesNoSignalHere) {
  signal(SIGPIPE, SIG_DFL);
  const std::string large(kPluginPayloadBytesMax, 'x');
  for (int i = 0; i < 5; ++i) {
    EXPECT_EQ(OneShot("exec 0<&-; exit 1").Ask(With(large)), Verdict::kNo);
  }
}

TEST_F(PluginTest, TellsWhoGreetsFromWhoDoesNot) {
  const std::string kept = Write("kept", Framed(kJudge));
  std::vector<PluginSpec> plugins = {{"a", Shell("exit 0")},
                                     {"b", kept},
                                     {"c", Shell("echo rips-plugin 2; cat >/dev/null")},
                                     {"d", Shell("cat >/dev/null")},
                                     {"e", Shell("head -c 1000000 /dev/zero")}};
  PluginOptions options = Patient();
  options.greeting_time = absl::Seconds(3);  // what `d` costs

  ::testing::internal::CaptureStderr();
  ASSERT_THAT(ProbePlugins(plugins, options, clock_), IsOk());

  const std::string log = ::testing::internal::GetCapturedStderr();
  for (const PluginSpec& plugin : plugins) {
    EXPECT_EQ(plugin.protocol == PluginProtocol::kFramed, plugin.id == "b") << plugin.id;
    const std::string said = absl::StrCat(
        "plugin sent no greeting; running it once per message (one-shot) plugin=", plugin.id,
        " greeting_time=3s\n");
    EXPECT_EQ(absl::StrContains(log, said), plugin.id != "b") << log;
  }
  std::vector<PluginSpec> none = {{"x", dir_ + "/none"}};
  EXPECT_THAT(ProbePlugins(none, options, clock_),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("/none`: No such file")));
}

TEST_F(PluginTest, ProgramsThatCannotStartAreFoundByProbing) {
  std::vector<PluginSpec> plugins = {
      {"import",
       Write("crash", "#!/usr/bin/python3 -S\nprint('loading', flush=True)\nimport nix\n")},
      {"good", Write("kept", Framed(kJudge))},
      {"env", Write("env", "#!/usr/bin/env no-such-program\n")},
      {"signal", Shell("kill -9 $$")},
      {"status", Shell("exit 126")},
      {"chatty", Shell("echo hello >&2; exit 0")},
      {"quiet", Shell("exit 1")}};

  const absl::Status status = ProbePlugins(plugins, Patient(), clock_);

  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  const std::vector<std::string> problems = absl::StrSplit(status.message(), '\n');
  EXPECT_THAT(problems,
              ElementsAre("plugin `import` does not start: exit status 1: Traceback (most recent "
                          "call last): ... ModuleNotFoundError: No module named 'nix'",
                          StartsWith("plugin `env` does not start: exit status 127: "),
                          "plugin `signal` does not start: ended by a signal",
                          "plugin `status` does not start: exit status 126",
                          "plugin `chatty` does not start: exit status 0: hello"));
}

TEST_F(PluginTest, AKeptProcessMayWriteErrors) {
  // More than a pipe holds, before its greeting and for each question.
  Plugin plugin = Kept(
      absl::StrCat("    os.write(2, b'x' * 100000)\n", kJudge, "os.write(2, b'y' * 100000)\n"));
  for (int i = 0; i < 5; ++i) EXPECT_EQ(plugin.Ask(With("bad")), Verdict::kYes);
  EXPECT_EQ(plugin.failures(), 0u);
}

TEST_F(PluginTest, AKeptProcessAnswersManyMessages) {
  Plugin plugin = Kept(kJudge);
  plugin.Warm();
  const std::string large(kPluginPayloadBytesMax, 'x');
  for (int i = 0; i < 20; ++i) {
    EXPECT_EQ(plugin.Ask(With("bad")), Verdict::kYes);
    EXPECT_EQ(plugin.Ask(With("good")), Verdict::kNo);
    EXPECT_EQ(plugin.Ask(With("")), Verdict::kNo);
    EXPECT_EQ(plugin.Ask(With("b")), Verdict::kNo);
  }
  EXPECT_EQ(plugin.Ask(With(large)), Verdict::kNo);
  EXPECT_EQ(plugin.starts(), 1u);
  EXPECT_EQ(plugin.failures(), 0u);
}

TEST_F(PluginTest, AKeptProcessMaySayThatItCannotTell) {
  Plugin plugin = Kept("    say('?\\n' if payload == b'odd' else '0\\n')\n");
  EXPECT_EQ(plugin.Ask(With("odd")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.Ask(With("x")), Verdict::kNo);
  EXPECT_EQ(plugin.starts(), 1u);
  EXPECT_EQ(plugin.failures(), 0u);
}

TEST_F(PluginTest, MessagesWithoutPayloadAreNotShown) {
  Plugin plugin = Kept(kJudge);
  Message message = With("bad");
  message.available = false;
  EXPECT_EQ(plugin.Ask(message), Verdict::kUnscanned);
  EXPECT_EQ(plugin.starts(), 0u);
}

TEST_F(PluginTest, TheHeaderSaysWhatTheMessageIs) {
  Message message = With("abc");
  message.topic = "/x\"y\n\xff";
  message.size_bytes = 7;
  EXPECT_EQ(PluginHeader(message),
            R"({"topic":"/x\"y\n\ufffd","type":"sensor_msgs/msg/Image","sender":"/eye",)"
            R"("writer":"01104a3b","time_unix_ns":1767225600000000007,"payload_bytes":3,)"
            R"("size_bytes":7})");
  Plugin plugin = Kept("    say('1\\n' if header['size_bytes'] == 7 else '0\\n')\n");
  EXPECT_EQ(plugin.Ask(message), Verdict::kYes);
  EXPECT_EQ(plugin.Ask(With("abc")), Verdict::kNo);

  const std::string long_name(kPluginHeaderBytesMax, 'x');
  message.topic = long_name;
  EXPECT_EQ(plugin.Ask(message), Verdict::kUnscanned);
  EXPECT_EQ(plugin.failures(), 0u);
}

TEST_F(PluginTest, EveryFailureOfAKeptProcessIsUnscannedAndTheNextMessageFindsANewOne) {
  const std::vector<std::pair<std::string, std::string>> failures = {
      {"crash", "os.kill(os.getpid(), signal.SIGSEGV)"},
      {"exit", "sys.exit(0)"},
      {"nonsense", "say('yes\\n')"},
      {"empty line", "say('\\n')"},
      {"twice", "say('0\\n0\\n')"},
      {"unfinished", "say('1'); sys.exit(0)"},
      {"closed output", "os.close(1); time.sleep(1000)"},
  };
  for (const auto& [what, action] : failures) {
    Plugin plugin = Kept(absl::StrCat("    if payload == b'fail': ", action, "\n", kJudge));
    EXPECT_EQ(plugin.Ask(With("bad")), Verdict::kYes) << what;
    EXPECT_EQ(plugin.Ask(With("fail")), Verdict::kUnscanned) << what;
    EXPECT_EQ(plugin.pid(), 0) << what;
    EXPECT_EQ(plugin.Ask(With("bad")), Verdict::kYes) << what;
    EXPECT_EQ(plugin.Ask(With("good")), Verdict::kNo) << what;
    EXPECT_EQ(plugin.starts(), 2u) << what;
    EXPECT_EQ(plugin.failures(), 1u) << what;
  }
}

TEST_F(PluginTest, WhatAKeptProcessSaysWhenItFailsIsLogged) {
  Plugin plugin = Kept("    raise ValueError('odd ' + payload.decode())\n");

  ::testing::internal::CaptureStderr();
  EXPECT_EQ(plugin.Ask(With("a\x1b[2J")), Verdict::kUnscanned);

  EXPECT_THAT(::testing::internal::GetCapturedStderr(),
              AllOf(HasSubstr("ended or closed its side without an answer: "),
                    HasSubstr("Traceback (most recent call last): ... ValueError: odd a?[2J\"")));
}

TEST_F(PluginTest, AKeptProcessThatHangsIsKilled) {
  PluginOptions options = Patient();
  options.answer_time = absl::Milliseconds(200);
  Plugin plugin = Kept("    time.sleep(1000)\n", options);
  plugin.Warm();
  const pid_t pid = plugin.pid();
  ASSERT_GT(pid, 0);
  // Until it has greeted, a message that is not answered is no failure.
  for (int i = 0; i < 300 && plugin.failures() == 0; ++i) {
    EXPECT_EQ(plugin.Ask(With("x")), Verdict::kUnscanned);
  }
  EXPECT_EQ(plugin.failures(), 1u);
  EXPECT_EQ(plugin.pid(), 0);
  EXPECT_FALSE(Alive(pid));
}

TEST_F(PluginTest, AKeptProcessThatClosesItsInputIsReplaced) {
  Plugin plugin = Kept(absl::StrCat(
      "    if payload == b'close':\n        os.close(0); say('0\\n'); time.sleep(1000)\n", kJudge));
  const std::string large(kPluginPayloadBytesMax, 'x');
  EXPECT_EQ(plugin.Ask(With("close")), Verdict::kNo);
  EXPECT_EQ(plugin.Ask(With(large)), Verdict::kUnscanned);
  EXPECT_EQ(plugin.Ask(With(large)), Verdict::kNo);
}

TEST_F(PluginTest, AKeptProcessThatEndsAfterEachAnswerIsRestartedForOthers) {
  PluginOptions options = Patient();
  options.restart = {.first = absl::Hours(1), .longest = absl::Hours(1)};
  Plugin plugin = Kept("    say('1\\n'); sys.exit(0)\n", options);
  EXPECT_EQ(plugin.Ask(With("x", "r1")), Verdict::kYes);
  // Whether it has ended yet is a matter of luck; either way r1 is to blame.
  EXPECT_EQ(plugin.Ask(With("x", "r1")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.Ask(With("x", "r1")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.Ask(With("x", "r2")), Verdict::kYes);
  EXPECT_EQ(plugin.starts(), 2u);
}

TEST_F(PluginTest, ARobotThatCrashesAPluginWaitsAlone) {
  PluginOptions options = Patient();
  options.restart = {.first = absl::Hours(1), .longest = absl::Hours(1)};
  Plugin plugin = Kept(
      absl::StrCat("    if payload == b'crash': os.kill(os.getpid(), signal.SIGSEGV)\n", kJudge),
      options);
  EXPECT_EQ(plugin.Ask(With("crash", "evil")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.Ask(With("good", "evil")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.starts(), 1u) << "in back-off nothing is started";
  EXPECT_EQ(plugin.Ask(With("bad", "other")), Verdict::kYes);
  EXPECT_EQ(plugin.Ask(With("good", "other")), Verdict::kNo);
}

TEST_F(PluginTest, AKeptProcessThatDoesNotComeUpCostsNothingMore) {
  PluginOptions options = Patient();
  options.restart = {.first = absl::Hours(1), .longest = absl::Hours(1)};
  for (const char* script : {"exit 0", "echo hello; cat >/dev/null", "printf rips-plu",
                             "printf 'rips-plugin 1\\n1\\n'; cat >/dev/null", "kill -9 $$"}) {
    Plugin plugin({"p", Shell(script), PluginProtocol::kFramed}, options, &clock_);
    for (const char* robot : {"r1", "r1", "r2", "r3"}) {
      EXPECT_EQ(plugin.Ask(With("x", robot)), Verdict::kUnscanned) << script;
    }
    EXPECT_EQ(plugin.starts(), 1u) << script;
  }
}

// A start is nobody's fault: who asks waits for it, and has all of `answer_time` afterwards.
TEST_F(PluginTest, TheStartIsNotPartOfTheAnswer) {
  PluginOptions options = Patient();
  options.answer_time = absl::Seconds(2);
  const std::string path = Write("late",
                                 "#!/bin/sh\nsleep 2.2\nprintf 'rips-plugin 1\\n'\n"
                                 "head -c 4 >/dev/null; printf '1\\n'\ncat >/dev/null\n");
  Plugin plugin({"p", path, PluginProtocol::kFramed}, options, &clock_);
  EXPECT_EQ(plugin.Ask(With("x")), Verdict::kYes);
  EXPECT_EQ(plugin.starts(), 1u);
  EXPECT_EQ(plugin.failures(), 0u);
  EXPECT_GT(plugin.TakeStartNs(), 2 * kNanosPerSecond);
  EXPECT_EQ(plugin.TakeStartNs(), 0);
}

TEST_F(PluginTest, AKeptProcessThatHangsAtStartIsGivenUp) {
  PluginOptions options = Hasty();
  options.greeting_time = absl::Milliseconds(20);
  options.restart = {.first = absl::Hours(1), .longest = absl::Hours(1)};
  Plugin plugin({"p", Shell("sleep 1000"), PluginProtocol::kFramed}, options, &clock_);
  // The first message may have used up its time before the process has.
  for (int i = 0; i < 1000 && plugin.failures() == 0; ++i) {
    EXPECT_EQ(plugin.Ask(With("x")), Verdict::kUnscanned);
  }
  EXPECT_EQ(plugin.failures(), 1u);
  EXPECT_EQ(plugin.pid(), 0);
  EXPECT_EQ(plugin.Ask(With("x")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.starts(), 1u);
}

TEST_F(PluginTest, AOneShotThatGreetsAfterAllIsKeptFromThenOn) {
  const std::string path = Write("kept", Framed(kJudge));
  Plugin plugin({"p", path, PluginProtocol::kOneShot}, Patient(), &clock_);
  EXPECT_EQ(plugin.Ask(With("good")), Verdict::kUnscanned);
  EXPECT_EQ(plugin.protocol(), PluginProtocol::kFramed);
  EXPECT_EQ(plugin.Ask(With("bad")), Verdict::kYes);
  EXPECT_EQ(plugin.Ask(With("good")), Verdict::kNo);
}

}  // namespace
}  // namespace rips::inspect
