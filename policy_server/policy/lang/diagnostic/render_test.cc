#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/lang/check/compile.h"

namespace rips::lang {
namespace {

using ::testing::HasSubstr;

std::string Text(const std::vector<SourceFile>& files) {
  return RenderText(files, Compile(files).diagnostics);
}

TEST(RenderTextTest, ShowsTheLineACaretAndAHint) {
  EXPECT_EQ(Text({{.path = "rules/demo.rul",
                   .text = "levels: A;\n\nrules Graph:\n\ttopicmatches(\"/camera.*\") ?\n"
                           "  alert(\"é\" + 1);\r\n"}}),
            "rules/demo.rul:4:2: error: `topicmatches` is about a message; it cannot be used in "
            "`rules Graph`\n"
            "    4 | \ttopicmatches(\"/camera.*\") ?\n"
            "      | \t^~~~~~~~~~~~\n"
            "      = hint: move the rule to a `rules Msg` section\n"
            "rules/demo.rul:5:13: error: `+` cannot join `string` and `int`\n"
            "    5 |   alert(\"é\" + 1);\n"
            "      |             ^\n"
            "      = hint: there is no implicit conversion; `string(x)` makes a string of any "
            "value\n");
}

TEST(RenderTextTest, SendsNoControlsToTheTerminal) {
  const std::string text = Text({{.path = "a\x1B[2J", .text = "levels: \x1B[31m;"}});
  EXPECT_EQ(text.find('\x1B'), std::string::npos);
  EXPECT_THAT(text, HasSubstr("unexpected character U+001B"));
}

TEST(RenderTextTest, CutsLongLinesAroundTheMistake) {
  const std::string text =
      Text({{.path = "t",
             .text = "levels: " + std::string(5000, ' ') + "@" + std::string(5000, ' ') + "A;"}});
  EXPECT_LT(text.size(), 600u);
  EXPECT_THAT(text, HasSubstr("... "));
  EXPECT_THAT(text, HasSubstr("@"));
}

TEST(RenderTextTest, MarksBytesThatAreNotUtf8) {
  EXPECT_THAT(Text({{.path = "t", .text = "é\xFFx"}}),
              HasSubstr("t:1:2: error: the file is not UTF-8 at byte offset 2\n"
                        "    1 | é\uFFFDx\n"
                        "      |  ^\n"));
}

TEST(RenderJsonTest, ListsEveryFile) {
  const std::vector<SourceFile> files = {
      {.path = "a\"\\\n\xFF.rul", .text = "levels: A;"},
      {.path = "b.rul",
       .text = "rules Msg: true ? alert(\"\\q\");\nx ? alert(\"\"); 017 == Time ? alert(\"\");"}};
  EXPECT_EQ(
      RenderJson(files, Compile(files).diagnostics),
      "{\"files\":[{\"path\":\"a\\\"\\\\\\u000a\uFFFD.rul\",\"ok\":true,\"diagnostics\":[]},"
      "{\"path\":\"b.rul\",\"ok\":false,\"diagnostics\":["
      "{\"line\":1,\"column\":25,\"severity\":\"error\",\"kind\":\"BadEscape\",\"message\":\"bad "
      "escape `\\\\q` in this string\",\"hint\":\"escapes are \\\\a \\\\b \\\\f \\\\n \\\\r \\\\t "
      "\\\\v \\\\\\\\ \\\\\\\" \\\\xHH \\\\ooo (up to \\\\377) \\\\uHHHH \\\\UHHHHHHHH; a "
      "backslash "
      "is written \\\\\\\\\"},"
      "{\"line\":2,\"column\":1,\"severity\":\"error\",\"kind\":\"UnknownName\",\"message\":"
      "\"unknown name `x`\",\"hint\":\"declare it under `vars:` or `consts:`; text is written in "
      "quotes: `\\\"x\\\"`\"},"
      "{\"line\":2,\"column\":16,\"severity\":\"warning\",\"kind\":\"LeadingZero\",\"message\":"
      "\"`017` is decimal\",\"hint\":\"octal is written `0o17`\"}]}]}");
}

TEST(RenderJsonTest, AnswersNoFilesWithAnEmptyList) {
  EXPECT_EQ(RenderJson({}, {}), "{\"files\":[]}");
}

}  // namespace
}  // namespace rips::lang
