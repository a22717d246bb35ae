#include "mode_actuator/steps/program/level_scripts.h"

#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <fstream>
#include <variant>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/config/config.h"
#include "services/base/status_matchers.h"
#include "services/runtime/config_reader.h"

namespace rips::actuator {
namespace {

using ::testing::HasSubstr;

class LevelScriptsTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (geteuid() != 0) GTEST_SKIP() << "scripts must belong to root";
    // Every directory on the way must be root's alone, which /tmp is not.
    char name[] = "/opt/rips-scripts-XXXXXX";
    ASSERT_NE(mkdtemp(name), nullptr);
    directory_ = name;
    chmod(name, 0755);
    levels_.resize(2);
    levels_[0].name = "DEFAULT";
    levels_[1].name = "ALERT";
  }
  void TearDown() override {
    if (directory_.empty()) return;
    [[maybe_unused]] const int ended = system(("rm -rf " + directory_).c_str());
  }
  void Write(const std::string& name, mode_t mode = 0755) const {
    const std::string path = directory_ + "/" + name;
    std::ofstream(path) << "#!/bin/sh\n";
    chmod(path.c_str(), mode);
  }
  absl::Status Add() { return AddLevelScripts(directory_, &levels_, &programs_, &settings_); }

  std::string directory_;
  std::vector<LevelSpec> levels_;
  std::vector<ProgramSpec> programs_;
  std::vector<ConfigSetting> settings_;
};

TEST_F(LevelScriptsTest, AreOneMoreStepOfTheirLevels) {
  Write("ALERT.to");
  Write("DEFAULT.from");
  Write(".hidden");
  Write("ALERT.to~");
  levels_[1].enter.emplace_back();
  ASSERT_THAT(Add(), IsOk());
  ASSERT_EQ(levels_[1].enter.size(), 2u);
  ASSERT_EQ(levels_[0].leave.size(), 1u);
  EXPECT_TRUE(levels_[1].leave.empty());
  const auto& enter = std::get<ProgramStep>(levels_[1].enter[1].what);
  EXPECT_EQ(enter.name, "ALERT.to");
  EXPECT_TRUE(enter.level_args);
  ASSERT_EQ(programs_.size(), 2u);
  EXPECT_EQ(programs_[0].path, directory_ + "/ALERT.to");
  EXPECT_TRUE(programs_[0].script);
  EXPECT_THAT(FormatSettings(settings_),
              HasSubstr("levels[1].enter[1].program.name: \"ALERT.to\""));
  EXPECT_THAT(FormatSettings(settings_),
              HasSubstr("levels[0].leave[0].program.name: \"DEFAULT.from\""));
}

TEST_F(LevelScriptsTest, EachMistakeIsTold) {
  Write("ALARM.to");
  Write("ALERT.on");
  Write("ALERT.to", 0775);
  Write("ALERT.from", 0644);
  ASSERT_EQ(symlink("ALERT.on", (directory_ + "/DEFAULT.to").c_str()), 0);
  Write("DEFAULT.from");
  programs_.emplace_back().name = "DEFAULT.from";
  const absl::Status status = Add();
  EXPECT_THAT(status, StatusIs(absl::StatusCode::kInvalidArgument));
  for (const char* part :
       {"/ALARM.to` is of no level; files are called LEVEL.from and LEVEL.to", "/ALERT.on` is of",
        "/ALERT.to` can be written by others", "/ALERT.from` is not executable",
        "/DEFAULT.to` is a symbolic link", "a program is called `DEFAULT.from` already"}) {
    EXPECT_THAT(std::string(status.message()), HasSubstr(part));
  }
  EXPECT_THAT(
      AddLevelScripts(directory_ + "/no", &levels_, &programs_, &settings_),
      StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("/no`: No such file or directory")));
}

TEST_F(LevelScriptsTest, TheirNumberHasALimit) {
  for (size_t i = 0; i <= kScriptFilesMax; ++i) Write(absl::StrCat("f", i));
  EXPECT_THAT(Add(), StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("exceed limit 256")));
}

TEST_F(LevelScriptsTest, ALevelWithItsScriptMustKeepItsTime) {
  Write("ALERT.to");
  ParsedConfig parsed;
  parsed.config.scripts = directory_;
  parsed.config.levels = levels_;
  Step& step = parsed.config.levels[1].enter.emplace_back();
  step.what = ProgramStep{.name = "x"};
  step.timeout = kLevelBudget - kScriptTimeout;
  ParsedConfig copy = parsed;
  EXPECT_THAT(AddScripts(&copy), IsOk());
  EXPECT_THAT(FormatSettings(copy.settings), HasSubstr("ALERT.to"));
  parsed.config.levels[1].enter[0].timeout += absl::Milliseconds(1);
  EXPECT_THAT(AddScripts(&parsed),
              StatusIs(absl::StatusCode::kInvalidArgument,
                       HasSubstr("level `ALERT` with its script: the steps may take 20.001s")));
}

}  // namespace
}  // namespace rips::actuator
