#include "policy_server/server/store/alert_log.h"

#include <sys/resource.h>

#include <csignal>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/store/store_test_data.h"
#include "services/base/status_matchers.h"

namespace rips::store {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

std::string Contents(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  std::stringstream out;
  out << in.rdbuf();
  return out.str();
}

// `?` for a line that is not an alert and nothing else.
std::vector<std::string> Texts(const std::string& path) {
  std::vector<std::string> texts;
  for (absl::string_view line : absl::StrSplit(Contents(path), '\n', absl::SkipEmpty())) {
    const auto alert = nlohmann::json::parse(line, nullptr, /*allow_exceptions=*/false);
    texts.push_back(alert.is_object() ? alert.value("text", "?") : "?");
  }
  return texts;
}

absl::Status Append(AlertLog& log, const std::string& text) {
  const AlertRecord alert = MakeAlert("r1", text);
  return log.Append({&alert, 1}).status();
}

TEST(AlertLineTest, HasTheDocumentedShape) {
  AlertRecord alert = MakeAlert("r1", "unknown node");
  alert.id = "0123456789abcdef0123456789abcdef";
  EXPECT_EQ(FormatAlertLine(alert),
            R"({"id":"0123456789abcdef0123456789abcdef","time":"2026-01-01T00:00:00.000000007Z",)"
            R"("robot":"r1","rule":"intruder","severity":"high","text":"unknown node",)"
            R"("level":"ALERT","event":"graph change","decision_id":"3.17",)"
            R"("maintenance":"","subjects":[]})");
  alert.maintenance = "in maintenance \x1b";
  EXPECT_THAT(FormatAlertLine(alert), HasSubstr(R"("maintenance":"in maintenance \u001b")"));
}

TEST(AlertLineTest, EscapesHostileText) {
  AlertRecord alert = MakeAlert("r1", "");
  alert.text = std::string(
      "\"\\\n\x1b[2J\x7f\xc2\x9b"
      "\xff"
      "\xc3"
      "\0z",
      14);
  EXPECT_THAT(FormatAlertLine(alert),
              HasSubstr(R"("text":"\"\\\n\u001b[2J\u007f\u009b\ufffd\ufffd\u0000z")"));
  alert.text = "\xe2\x82";  // cut in the middle of a character
  EXPECT_THAT(FormatAlertLine(alert), HasSubstr(R"("text":"\ufffd")"));
  alert.text = "\xf0\x9f\xa4\x96";
  EXPECT_THAT(FormatAlertLine(alert), HasSubstr(R"("text":"\ud83e\udd16")"));
}

TEST(AlertLogTest, AppendsToWhatIsThere) {
  TempDir dir;
  const std::string path = dir.File("alerts.jsonl");
  for (const char* text : {"one", "two"}) {
    auto log = AlertLog::Open(path);
    ASSERT_THAT(log, IsOk());
    ASSERT_THAT(Append(**log, text), IsOk());
  }
  EXPECT_THAT(Texts(path), ElementsAre("one", "two"));
}

TEST(AlertLogTest, FollowsARotation) {
  TempDir dir;
  const std::string path = dir.File("alerts.jsonl");
  auto log = AlertLog::Open(path);
  ASSERT_THAT(log, IsOk());
  ASSERT_THAT(Append(**log, "old"), IsOk());

  std::filesystem::rename(path, path + ".1");
  ASSERT_THAT(Append(**log, "new"), IsOk());
  EXPECT_THAT(Texts(path + ".1"), ElementsAre("old"));
  EXPECT_THAT(Texts(path), ElementsAre("new"));

  std::filesystem::rename(path, path + ".2");
  ASSERT_THAT((*log)->Reopen(), IsOk());
  EXPECT_TRUE(std::filesystem::exists(path));
  ASSERT_THAT(Append(**log, "newer"), IsOk());
  EXPECT_THAT(Texts(path), ElementsAre("newer"));
}

TEST(AlertLogTest, CutsATornLineOffWhenItOpens) {
  TempDir dir;
  const std::string path = dir.File("alerts.jsonl");
  std::ofstream(path) << "{\"id\":\"cut";
  {
    auto log = AlertLog::Open(path);
    ASSERT_THAT(log, IsOk());
    EXPECT_EQ(*(*log)->LastId(), "");
    ASSERT_THAT(Append(**log, "whole"), IsOk());
  }
  std::ofstream(path, std::ios::app) << "{\"id\":\"cut again";
  auto log = AlertLog::Open(path);
  ASSERT_THAT(log, IsOk());
  ASSERT_THAT(Append(**log, "next"), IsOk());
  EXPECT_THAT(Texts(path), ElementsAre("whole", "next"));
}

TEST(AlertLogTest, KnowsTheAlertOnItsLastLine) {
  TempDir dir;
  const std::string path = dir.File("alerts.jsonl");
  auto log = AlertLog::Open(path);
  ASSERT_THAT(log, IsOk());
  EXPECT_EQ(*(*log)->LastId(), "");
  const AlertRecord first = MakeAlert("r1", "one");
  const AlertRecord last = MakeAlert("r1", std::string(100'000, 'x'));
  const AlertRecord both[] = {first, last};
  ASSERT_THAT((*log)->Append(both), IsOk());
  EXPECT_EQ(*(*log)->LastId(), last.id);
  std::ofstream(path, std::ios::app) << "somebody's note\n";
  EXPECT_EQ(*(*log)->LastId(), "");
}

TEST(AlertLogTest, ReportsAFullDiskAndGoesOn) {
  TempDir dir;
  const std::string path = dir.File("alerts.jsonl");
  auto log = AlertLog::Open(path);
  ASSERT_THAT(log, IsOk());
  ASSERT_THAT(Append(**log, "before"), IsOk());

  rlimit unlimited = {};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &unlimited), 0);
  const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit tight = {std::filesystem::file_size(path) + 20, unlimited.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &tight), 0);
  const absl::Status full = Append(**log, "lost");
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &unlimited), 0);
  std::signal(SIGXFSZ, old_handler);

  EXPECT_THAT(full, StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr(path)));
  ASSERT_THAT(Append(**log, "after"), IsOk());
  EXPECT_THAT(Texts(path), ElementsAre("before", "after"));
}

TEST(AlertLogTest, RefusesWhatIsNotAFile) {
  TempDir dir;
  EXPECT_THAT(AlertLog::Open(dir.File("")), StatusIs(absl::StatusCode::kUnavailable));
  EXPECT_THAT(AlertLog::Open(dir.File("none/alerts.jsonl")),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("No such file")));
  EXPECT_THAT(AlertLog::Open("/dev/null"),
              StatusIs(absl::StatusCode::kUnavailable, HasSubstr("not a regular file")));
}

}  // namespace
}  // namespace rips::store
