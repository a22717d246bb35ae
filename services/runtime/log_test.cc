#include "services/runtime/log.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips {
namespace {

using ::testing::HasSubstr;
using ::testing::MatchesRegex;

TEST(LogTest, WritesOneLineWithTimeLevelAndFields) {
  ::testing::internal::CaptureStderr();
  LogInfo("listening", {{"address", "127.0.0.1:7443"}, {"robots", 3}, {"drained", false}});
  const std::string line = ::testing::internal::GetCapturedStderr();

  EXPECT_THAT(line, MatchesRegex("20[0-9][0-9]-[0-9][0-9]-[0-9][0-9]T[0-9][0-9]:[0-9][0-9]:"
                                 "[0-9][0-9]\\.[0-9][0-9][0-9]Z info listening "
                                 "address=127.0.0.1:7443 robots=3 drained=false\n"));
}

TEST(LogTest, WritesOnlyEnabledLevels) {
  SetLogLevel(LogLevel::kWarning);
  ::testing::internal::CaptureStderr();
  LogDebug("a");
  LogInfo("b");
  LogWarning("c");
  LogError("d");
  const std::string lines = ::testing::internal::GetCapturedStderr();
  SetLogLevel(LogLevel::kInfo);

  EXPECT_THAT(lines, MatchesRegex("[^ ]+ warning c\n[^ ]+ error d\n"));
}

TEST(LogTest, QuotesAndEscapesWhatCouldForgeALine) {
  struct Case {
    std::string value;
    std::string written;
  };
  const Case cases[] = {
      {"/camera/image_raw", "/camera/image_raw"},
      {"grün", "grün"},
      {"", "\"\""},
      {"two words", "\"two words\""},
      {"a=b", "\"a=b\""},
      {"say \"hi\"", "\"say \\\"hi\\\"\""},
      {"back\\slash", "\"back\\\\slash\""},
      {"x\n2026-01-01T00:00:00.000Z error forged", "\"x\\n2026-01-01T00:00:00.000Z error forged\""},
      {"tab\t", "\"tab\\t\""},
      {std::string("nul\0", 4), "\"nul\\x00\""},
      {"\x1b[31mred", "\"\\x1b[31mred\""},
      {"\x7f", "\"\\x7f\""},
      {"\xc2\x9b", "\"\\xc2\\x9b\""},                    // C1 control
      {"\xe2\x80\xaegnp", "\"\\xe2\\x80\\xaegnp\""},     // right-to-left override
      {"\xe2\x80\xa8", "\"\\xe2\\x80\\xa8\""},           // line separator
      {"\xff\xfe", "\"\\xff\\xfe\""},                    // not UTF-8
      {"\xc0\x8a", "\"\\xc0\\x8a\""},                    // overlong line feed
      {"\xed\xa0\x80", "\"\\xed\\xa0\\x80\""},           // surrogate
      {"\xe2\x82", "\"\\xe2\\x82\""},                    // cut short
      {"\xf0\x9f\xa4\x96", "\xf0\x9f\xa4\x96"},          // U+1F916
      {"\xf4\x90\x80\x80", "\"\\xf4\\x90\\x80\\x80\""},  // above U+10FFFF
  };
  for (const Case& c : cases) {
    EXPECT_EQ(FormatLogMessage("m", {{"k", c.value}}), "m k=" + c.written);
  }
}

TEST(LogTest, CutsALongValue) {
  const std::string fits(kLogValueBytesMax, 'x');

  EXPECT_EQ(FormatLogMessage("m", {{"k", fits}}), "m k=" + fits);
  EXPECT_EQ(FormatLogMessage("m", {{"k", fits + "y"}}), "m k=\"" + fits + "\"...");
}

TEST(LogTest, KnowsTheNamesOfLevels) {
  EXPECT_EQ(*ParseLogLevel("debug"), LogLevel::kDebug);
  EXPECT_EQ(*ParseLogLevel("error"), LogLevel::kError);
  EXPECT_THAT(ParseLogLevel("Info"), StatusIs(absl::StatusCode::kInvalidArgument,
                                              HasSubstr("unknown log level `Info`; use `debug`")));
}

}  // namespace
}  // namespace rips
