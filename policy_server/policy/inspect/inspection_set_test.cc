#include "policy_server/policy/inspect/inspection_set.h"

#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <string>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/inspect/inspection_pool.h"
#include "services/base/status_matchers.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::inspect {
namespace {

using engine::Verdict;
using lang::Inspection;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using Kind = lang::InspectionProblem::Kind;

constexpr char kRule[] = "rule r { strings: $a = \"attack\" condition: $a }";

Inspection Payload(const std::string& path) {
  return {.kind = Inspection::Kind::kPayload, .name = path, .path = path};
}
Inspection PluginAt(const std::string& path) {
  return {.kind = Inspection::Kind::kPlugin, .name = "p", .path = path};
}

auto OneProblem(Kind kind, const std::string& message) {
  return ElementsAre(AllOf(Field(&lang::InspectionProblem::kind, kind),
                           Field(&lang::InspectionProblem::message, HasSubstr(message))));
}

// Files in memory; counts how often each is read.
class FakeFiles final : public FileSource {
 public:
  absl::StatusOr<std::string> Read(absl::string_view path, size_t bytes_max) const override {
    ++reads[std::string(path)];
    const auto found = texts.find(std::string(path));
    if (found == texts.end()) return absl::NotFoundError(absl::StrCat("no file `", path, "`"));
    if (found->second.size() > bytes_max) {
      return absl::ResourceExhaustedError(absl::StrCat("`", path, "` is too long"));
    }
    return found->second;
  }
  absl::StatusOr<std::string> ProgramPath(const Inspection& plugin) const override {
    if (plugin.path == "undeclared") return absl::NotFoundError("no plugin `undeclared`");
    return plugin.path;
  }

  std::map<std::string, std::string> texts;
  mutable std::map<std::string, int> reads;
};

class InspectionSetTest : public ::testing::Test {
 protected:
  InspectionSetTest() {
    std::string name = ::testing::TempDir() + "/inspectXXXXXX";
    dir_ = mkdtemp(name.data());
    options_.scan_time = absl::Seconds(60);
    options_.plugin.answer_time = absl::Seconds(60);
  }
  ~InspectionSetTest() override { std::filesystem::remove_all(dir_); }

  std::string Write(const std::string& name, const std::string& text, mode_t mode = 0755) {
    const std::string path = dir_ + "/" + name;
    std::ofstream(path) << text;
    EXPECT_EQ(chmod(path.c_str(), mode), 0);
    return path;
  }
  absl::StatusOr<std::shared_ptr<const InspectionSet>> Load(
      const std::vector<Inspection>& inspections) {
    return LoadInspections(inspections, checked_, options_, &clock_);
  }
  static Message With(absl::string_view payload) {
    return {.robot = "r1",
            .payload = payload,
            .size_bytes = static_cast<uint32_t>(payload.size()),
            .available = true};
  }

  RealClock clock_;
  std::string dir_;
  FakeFiles files_;
  CheckedFiles checked_{&files_};
  InspectOptions options_;
};

TEST_F(InspectionSetTest, ChecksYaraFiles) {
  files_.texts["good.yar"] = kRule;
  files_.texts["broken.yar"] = "rule {";
  files_.texts["slow.yar"] = "rule r { strings: $a = \"a\" condition: $a }";
  files_.texts["long.yar"] = std::string(kYaraFileBytesMax + 1, ' ');

  EXPECT_THAT(checked_.Check(Payload("good.yar")), IsEmpty());
  EXPECT_THAT(checked_.Check(Payload("none.yar")),
              OneProblem(Kind::kMissing, "no file `none.yar`"));
  EXPECT_THAT(checked_.Check(Payload("broken.yar")), OneProblem(Kind::kBroken, "broken.yar:1: "));
  EXPECT_THAT(checked_.Check(Payload("slow.yar")), OneProblem(Kind::kSlow, "slow.yar:1: "));
  EXPECT_THAT(checked_.Check(Payload("long.yar")), OneProblem(Kind::kBroken, "is too long"));
}

TEST_F(InspectionSetTest, ChecksPluginsWithoutRunningThem) {
  const std::string mark = dir_ + "/ran";
  const std::string good = Write("good", "#!/bin/sh\nmkdir " + mark + "\n");
  ASSERT_EQ(symlink(good.c_str(), (dir_ + "/link").c_str()), 0);

  EXPECT_THAT(checked_.Check(PluginAt(good)), IsEmpty());
  EXPECT_THAT(checked_.Check(PluginAt(dir_ + "/link")), IsEmpty());
  EXPECT_THAT(checked_.Check(PluginAt(dir_ + "/none")), OneProblem(Kind::kMissing, "No such file"));
  EXPECT_THAT(checked_.Check(PluginAt(dir_)), OneProblem(Kind::kBroken, "not a regular file"));
  EXPECT_THAT(checked_.Check(PluginAt(Write("plain", "", 0644))),
              OneProblem(Kind::kMissing, "not executable"));
  EXPECT_THAT(checked_.Check(PluginAt("undeclared")),
              OneProblem(Kind::kMissing, "no plugin `undeclared`"));
  EXPECT_FALSE(std::filesystem::exists(mark));
}

TEST_F(InspectionSetTest, ChecksTheInterpreterOfAScript) {
  const std::string none = dir_ + "/nonexist";
  const auto script = [this](const std::string& text) { return PluginAt(Write("script", text)); };
  for (const std::string& text :
       {"#!" + none, "#!" + none + "\n", "#! \t" + none + " -S\nexit 0\n", "#!" + none + "\tx\n"}) {
    EXPECT_THAT(checked_.Check(script(text)),
                OneProblem(Kind::kMissing,
                           absl::StrCat("script: its interpreter `", none, "` is not there")))
        << text;
  }
  EXPECT_THAT(checked_.Check(script("#!/bin/sh\r\nexit 0\r\n")),
              OneProblem(Kind::kMissing, "its interpreter `/bin/sh\\r` is not there"));
  const std::string plain = Write("plain", "", 0644);
  EXPECT_THAT(
      checked_.Check(script("#!" + plain + "\n")),
      OneProblem(Kind::kMissing, absl::StrCat("its interpreter `", plain, "` is not executable")));
  EXPECT_THAT(checked_.Check(script("#!" + dir_ + "\n")),
              OneProblem(Kind::kMissing, "is not executable"));
  for (const char* good : {"#!/bin/sh", "#! /bin/sh -e\n", "#!bin/sh\n", "", "#", "#!\n", "\x7f"}) {
    EXPECT_THAT(checked_.Check(script(good)), IsEmpty()) << good;
  }
  EXPECT_THAT(checked_.Check(script("#!/" + std::string(1 << 20, 'x'))),
              OneProblem(Kind::kMissing, "is not there"));
}

TEST_F(InspectionSetTest, WhatWasCheckedIsWhatIsUsed) {
  files_.texts["x.yar"] = kRule;
  EXPECT_THAT(checked_.Check(Payload("x.yar")), IsEmpty());
  files_.texts["x.yar"] = "rubbish";

  const auto set = Load({Payload("x.yar")});

  ASSERT_THAT(set, IsOk());
  EXPECT_EQ((*set)->NewSession()->Inspect(0, With("attack")), Verdict::kYes);
  EXPECT_EQ(files_.reads["x.yar"], 1);
}

TEST_F(InspectionSetTest, LoadReportsEveryProblemOfEveryFile) {
  files_.texts["broken.yar"] = "rule a { condition: one }\nrule b { condition: two }";
  EXPECT_THAT(Load({Payload("broken.yar"), Payload("none.yar"), PluginAt(dir_ + "/none")}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("broken.yar:1: undefined identifier \"one\"\n"),
                             HasSubstr("broken.yar:2: undefined identifier \"two\"\n"),
                             HasSubstr("no file `none.yar`\n"), HasSubstr("/none: No such file"))));
}

TEST_F(InspectionSetTest, LoadRefusesWhatCannotBeExecuted) {
  EXPECT_THAT(Load({PluginAt(Write("text", "no program"))}),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("Exec format error")));
}

TEST_F(InspectionSetTest, LoadRefusesAPluginThatCannotStart) {
  options_.plugin.greeting_time = absl::Seconds(60);
  const std::string plugin = Write("plugin", "#!/usr/bin/python3 -S\nimport no_such_module\n");
  EXPECT_THAT(Load({PluginAt(plugin)}),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       "plugin `p` does not start: exit status 1: Traceback (most recent call "
                       "last): ... ModuleNotFoundError: No module named 'no_such_module'"));
  EXPECT_THAT(Load({PluginAt(Write("silent", "#!/bin/sh\nexit 1\n"))}), IsOk());
}

// Whoever asks one message after another, as a replay, is not held up by each.
TEST_F(InspectionSetTest, APluginThatHangsCostsASessionAFewQuestions) {
  files_.texts["a.yar"] = kRule;
  options_.plugin.greeting_time = absl::Milliseconds(200);
  options_.plugin.answer_time = absl::Milliseconds(20);
  options_.plugin.restart = {.first = absl::Hours(1), .longest = absl::Hours(1)};
  // Each start says so on standard error, of which the log shows the first failure; so they are
  // counted by the time that they take instead.
  const auto plugin = [this](const std::string& name, const std::string& greeting) {
    return PluginAt(Write(name, absl::StrCat("#!/bin/sh\n", greeting, "\nexec sleep 1000\n")));
  };
  const auto set =
      Load({plugin("framed", "echo rips-plugin 1"), plugin("once", ""), Payload("a.yar")});
  ASSERT_THAT(set, IsOk());
  const std::unique_ptr<Session> session = (*set)->NewSession();

  const int64_t before_ns = BoottimeNow();
  for (int i = 0; i < 1000; ++i) {
    EXPECT_EQ(session->Inspect(0, With("x")), Verdict::kUnscanned);
    EXPECT_EQ(session->Inspect(1, With("x")), Verdict::kUnscanned);
    EXPECT_EQ(session->Inspect(2, With("attack")), Verdict::kYes);
  }

  // A thousand answers of 20 ms each, twice, and as many starts would take 40 s.
  EXPECT_LT(BoottimeNow() - before_ns, 15 * kNanosPerSecond);
}

// One thread, a rule that the load check does not find, and payloads made for it.
TEST_F(InspectionSetTest, AStuckScanCostsNobodyButItsRobot) {
  files_.texts["trap.yar"] =
      "rule r { strings: $a = /abcd(.{0,50}efgh){1,20}zzzz/s $b = \"attack\" condition: any of "
      "them }";
  options_.scan_time = absl::Milliseconds(100);
  const auto set = Load({Payload("trap.yar")});
  ASSERT_THAT(set, IsOk());
  std::string stuck;
  for (int i = 0; i < 4000; ++i) stuck += "abcdefgh";
  const std::string attack = "attack";
  Mutex mu;
  CondVar changed;
  std::map<std::string, std::vector<Verdict>> verdicts;
  size_t answered = 0;
  InspectionPool pool({.threads = 1}, &clock_);
  const auto submit = [&](const std::string& robot, const std::string& payload) {
    const Skipped skipped =
        pool.Submit({.set = *set,
                     .indices = {0},
                     .message = {.robot = robot, .payload = payload, .available = true}},
                    [&, robot](std::vector<Verdict> given, const InspectionStats&) {
                      MutexLock lock(&mu);
                      verdicts[robot].push_back(given[0]);
                      ++answered;
                      changed.NotifyAll();
                    });
    EXPECT_EQ(skipped, Skipped::kNot);
  };
  for (int i = 0; i < 10; ++i) {
    for (const char* evil : {"evil1", "evil2", "evil3", "evil4", "evil5"}) submit(evil, stuck);
    for (const char* good : {"good1", "good2"}) submit(good, attack);
  }
  {
    MutexLock lock(&mu);
    while (answered < 70) changed.Wait(lock);
  }

  for (const auto& [robot, given] : verdicts) {
    EXPECT_THAT(given, ::testing::Each(absl::StartsWith(robot, "good") ? Verdict::kYes
                                                                       : Verdict::kUnscanned))
        << robot;
  }
  pool.Stop();
}

TEST_F(InspectionSetTest, InspectionsAreLimited) {
  files_.texts["x.yar"] = kRule;
  EXPECT_THAT(Load(std::vector<Inspection>(kInspectionsMax, Payload("x.yar"))), IsOk());
  EXPECT_THAT(Load(std::vector<Inspection>(kInspectionsMax + 1, Payload("x.yar"))),
              StatusIs(absl::StatusCode::kResourceExhausted, "257 inspections exceed limit 256"));
}

TEST_F(InspectionSetTest, AsksScannersAndPluginsByIndex) {
  files_.texts["a.yar"] = kRule;
  files_.texts["b.yar"] = "rule r { condition: filesize < 3 }";
  options_.plugin.greeting_time = absl::Milliseconds(100);
  const std::string plugin = Write("plugin", "#!/bin/sh\ngrep -q plug\n");
  const auto set = Load({Payload("a.yar"), PluginAt(plugin), Payload("b.yar")});
  ASSERT_THAT(set, IsOk());
  EXPECT_EQ((*set)->size(), 3u);
  const std::unique_ptr<Session> session = (*set)->NewSession();

  EXPECT_EQ(session->Inspect(0, With("attack")), Verdict::kYes);
  EXPECT_EQ(session->Inspect(0, With("plug")), Verdict::kNo);
  EXPECT_EQ(session->Inspect(1, With("attack")), Verdict::kNo);
  EXPECT_EQ(session->Inspect(1, With("plug")), Verdict::kYes);
  EXPECT_EQ(session->Inspect(2, With("x")), Verdict::kYes);
  EXPECT_EQ(session->Inspect(2, With("plug")), Verdict::kNo);
  EXPECT_EQ(session->Inspect(3, With("x")), Verdict::kUnscanned) << "no such inspection";
}

TEST_F(InspectionSetTest, AMissingPayloadIsUnscannedAndAnEmptyOneIsNot) {
  files_.texts["a.yar"] = kRule;
  const auto set = Load({Payload("a.yar")});
  ASSERT_THAT(set, IsOk());
  const std::unique_ptr<Session> session = (*set)->NewSession();
  Message missing = With("attack");
  missing.available = false;

  EXPECT_EQ(session->Inspect(0, missing), Verdict::kUnscanned);
  EXPECT_EQ(session->Inspect(0, With("")), Verdict::kNo);
}

TEST_F(InspectionSetTest, ScansTheFirstBytesOnly) {
  files_.texts["a.yar"] = kRule;
  options_.payload_bytes_max = 100;
  const auto set = Load({Payload("a.yar")});
  ASSERT_THAT(set, IsOk());
  const std::unique_ptr<Session> session = (*set)->NewSession();

  EXPECT_EQ(session->Inspect(0, With(std::string(94, 'x') + "attack")), Verdict::kYes);
  EXPECT_EQ(session->Inspect(0, With(std::string(95, 'x') + "attack")), Verdict::kUnscanned);
  EXPECT_EQ(session->Inspect(0, With(std::string(100, 'x'))), Verdict::kNo) << "all of it was seen";
}

TEST_F(InspectionSetTest, APayloadIsScannedUpToTheHardLimit) {
  files_.texts["a.yar"] = kRule;
  const auto set = Load({Payload("a.yar")});
  ASSERT_THAT(set, IsOk());
  const std::unique_ptr<Session> session = (*set)->NewSession();

  EXPECT_EQ(session->Inspect(0, With(std::string(70'000, 'x') + "attack")), Verdict::kYes);
  EXPECT_EQ(session->Inspect(0, With(std::string(70'000, 'x'))), Verdict::kNo);
  const std::string hard(kPayloadBytesHard - 6, 'x');
  EXPECT_EQ(session->Inspect(0, With(hard + "attack")), Verdict::kYes);
  EXPECT_EQ(session->Inspect(0, With(hard + "xattack")), Verdict::kUnscanned);
}

// What was not found in the part that came may be in the rest.
TEST_F(InspectionSetTest, ANoOfAPayloadThatWasCutIsUnscanned) {
  files_.texts["a.yar"] = kRule;
  options_.plugin.greeting_time = absl::Milliseconds(100);
  const std::string once = Write("once", "#!/bin/sh\ngrep -q attack\n");
  const auto set = Load({Payload("a.yar"), PluginAt(once)});
  ASSERT_THAT(set, IsOk());
  const std::unique_ptr<Session> session = (*set)->NewSession();
  for (const uint32_t index : {0u, 1u}) {
    Message good = With("good");
    EXPECT_EQ(session->Inspect(index, good), Verdict::kNo);
    ++good.size_bytes;
    EXPECT_EQ(session->Inspect(index, good), Verdict::kUnscanned);
    Message bad = With("an attack");
    bad.size_bytes += 1'000'000;
    EXPECT_EQ(session->Inspect(index, bad), Verdict::kYes) << "a match is a match";
  }
}

TEST_F(InspectionSetTest, ASessionOutlivesItsSet) {
  files_.texts["a.yar"] = kRule;
  auto set = Load({Payload("a.yar")});
  ASSERT_THAT(set, IsOk());
  const std::unique_ptr<Session> session = (*set)->NewSession();
  set->reset();
  EXPECT_EQ(session->Inspect(0, With("attack")), Verdict::kYes);
}

TEST_F(InspectionSetTest, DiskFilesAreReadWhereTheyAre) {
  const DiskFiles disk;
  const std::string path = Write("x.yar", kRule);

  EXPECT_THAT(disk.Read(path, 1000), IsOk());
  EXPECT_THAT(disk.Read(path, 3), StatusIs(absl::StatusCode::kResourceExhausted));
  EXPECT_THAT(disk.Read(dir_ + "/none", 1000), StatusIs(absl::StatusCode::kNotFound));
  EXPECT_EQ(*disk.ProgramPath(PluginAt("/a/plugin")), "/a/plugin");
  EXPECT_EQ(*disk.ProgramPath(PluginAt("plugins/x")),
            (std::filesystem::current_path() / "plugins/x").string());
}

// The plugin that is shipped, through the real protocol.
TEST_F(InspectionSetTest, TheShippedBlindingPluginIsFramed) {
  options_.plugin.greeting_time = absl::Seconds(60);
  const auto set = Load({PluginAt(RIPS_BIN_DIR "/rips-plugin-blinding")});
  ASSERT_THAT(set, IsOk());
  const std::unique_ptr<Session> session = (*set)->NewSession();

  // 8 x 8 mono8, little endian: stamp, frame id "", height, width, "mono8", big endian 0, step,
  // data.
  const auto image = [](char pixel) {
    std::string cdr(
        "\0\1\0\0"
        "\0\0\0\0\0\0\0\0"
        "\1\0\0\0\0\0\0\0"
        "\x8\0\0\0\x8\0\0\0"
        "\6\0\0\0mono8\0\0\0"
        "\x8\0\0\0\x40\0\0\0",
        48);
    return cdr + std::string(64, pixel);
  };
  EXPECT_EQ(session->Inspect(0, With(image('\xff'))), Verdict::kYes);
  EXPECT_EQ(session->Inspect(0, With(image('\x80'))), Verdict::kNo);
  EXPECT_EQ(session->Inspect(0, With("rubbish")), Verdict::kUnscanned);
}

}  // namespace
}  // namespace rips::inspect
