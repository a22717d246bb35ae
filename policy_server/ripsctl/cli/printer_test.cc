#include "policy_server/ripsctl/cli/printer.h"

#include <fcntl.h>
#include <stdlib.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <sstream>
#include <string>

#include "gtest/gtest.h"
#include "services/text/utf8.h"

namespace rips::ripsctl {
namespace {

TEST(EscapeTextTest, KeepsOrdinaryText) {
  EXPECT_EQ(EscapeText(""), "");
  EXPECT_EQ(EscapeText("node /talker, 3 \"quotes\" \\ back"), "node /talker, 3 \"quotes\" \\ back");
  EXPECT_EQ(EscapeText("ñandú 机器人 🤖"), "ñandú 机器人 🤖");
}

TEST(EscapeTextTest, MakesHostileTextHarmless) {
  EXPECT_EQ(EscapeText("\x1b[2J"), "\\x1b[2J");
  EXPECT_EQ(EscapeText("a\r\n\tb\x7f"), "a\\x0d\\x0a\\x09b\\x7f");
  EXPECT_EQ(EscapeText(std::string("\0", 1)), "\\x00");
  EXPECT_EQ(EscapeText("\xc2\x9b"
                       "31m"),
            "\\u009b31m")
      << "C1 control sequence introducer";
  EXPECT_EQ(EscapeText("\xe2\x80\xae"
                       "txt"),
            "\\u202etxt")
      << "right-to-left override";
  EXPECT_EQ(EscapeText("a\xe2\x80\x8b"
                       "b"),
            "a\\u200bb")
      << "zero-width space";
  EXPECT_EQ(EscapeText("\xf3\xa0\x81\x81"), "\\ue0041") << "tag character";
}

TEST(EscapeTextTest, ShowsBytesThatAreNotUtf8) {
  EXPECT_EQ(EscapeText("\xff"), "\\xff");
  EXPECT_EQ(EscapeText("\xc0\xaf"), "\\xc0\\xaf") << "overlong";
  EXPECT_EQ(EscapeText("\xe0\x80\xaf"), "\\xe0\\x80\\xaf") << "overlong";
  EXPECT_EQ(EscapeText("\xed\xa0\x80"), "\\xed\\xa0\\x80") << "surrogate";
  EXPECT_EQ(EscapeText("\xf4\x90\x80\x80"), "\\xf4\\x90\\x80\\x80") << "beyond U+10FFFF";
  const std::string robot = "\xf0\x9f\xa4\x96";
  for (size_t cut = 1; cut < robot.size(); ++cut) {
    EXPECT_EQ(EscapeText(robot.substr(0, cut)).substr(0, 4), "\\xf0") << cut;
    EXPECT_TRUE(FindInvalidUtf8(robot.substr(0, cut)));
  }
  EXPECT_FALSE(FindInvalidUtf8(robot));
}

TEST(TableTest, AlignsByCodePointsAndEscapes) {
  Table table({"NAME", "LEVEL", "TEXT"});
  table.Add({"ñ", "COMPROMISED", "\x1b[2J"});
  table.Add({"longer", "", "x"});
  std::ostringstream out;
  table.Print(out);
  EXPECT_EQ(out.str(),
            "NAME    LEVEL        TEXT\n"
            "ñ       COMPROMISED  \\x1b[2J\n"
            "longer  -            x\n");
}

TEST(TimeTest, IsUtc) {
  EXPECT_EQ(ShortTime(1'767'225'600'123'456'789), "2026-01-01T00:00:00.123Z");
  EXPECT_EQ(FullTime(1'767'225'600'123'456'789), "2026-01-01T00:00:00.123456789Z");
  EXPECT_EQ(ShortTime(0), "-");
}

TEST(ShortBundleTest, KeepsTwelveDigits) {
  EXPECT_EQ(ShortBundle("sha256:" + std::string(64, 'a')), "sha256:aaaaaaaaaaaa");
  EXPECT_EQ(ShortBundle(""), "");
  EXPECT_EQ(ShortBundle("odd"), "odd");
}

TEST(ShortIdTest, KeepsEightDigits) {
  EXPECT_EQ(ShortId(std::string(32, 'a')), "aaaaaaaa");
  EXPECT_EQ(ShortId("abc"), "abc");
}

std::string Wrapped(const std::string& text, const std::string& margin, size_t columns) {
  std::ostringstream out;
  PrintWrapped(text, margin, columns, out);
  return out.str();
}

TEST(PrintWrappedTest, BreaksAtBlanksAndWithinWordsThatAreTooLong) {
  EXPECT_EQ(Wrapped("the aisle is clear", "  ", 11), "  the aisle\n  is clear\n");
  EXPECT_EQ(Wrapped("the aisle is clear", "  ", 10), "  the\n  aisle is\n  clear\n");
  EXPECT_EQ(Wrapped("spiffe://fleet.example is", "", 8), "spiffe:/\n/fleet.e\nxample\nis\n");
  EXPECT_EQ(Wrapped("\xc3\xb1\xc3\xb1 \xc3\xb1\xc3\xb1", "", 2),
            "\xc3\xb1\xc3\xb1\n\xc3\xb1\xc3\xb1\n");
  EXPECT_EQ(Wrapped("a\nb", "", 80), "a\\x0ab\n") << "escaped";
  EXPECT_EQ(Wrapped("", "  ", 80), "  \n");
}

TEST(PrintWrappedTest, IsOneLineWithoutAWidth) {
  const std::string text = "a reason of " + std::string(1'000, 'x') + " and more";
  EXPECT_EQ(Wrapped(text, "    ", 0), "    " + text + "\n");
  EXPECT_EQ(Wrapped(text, "    ", 4), "    " + text + "\n") << "no room beside the margin";
}

TEST(PrintWrappedTest, LosesNothingAtAnyWidth) {
  const std::string text = "operator alice (spiffe://a.b/operator/admin/alice serial 0f): it is ok";
  for (size_t columns = 1; columns < 100; ++columns) {
    std::istringstream lines(Wrapped(text, "  ", columns));
    std::string all;
    for (std::string line; std::getline(lines, line);) {
      EXPECT_LE(line.size(), columns > 2 ? columns : 2 + text.size());
      all += line;
    }
    std::erase(all, ' ');
    std::string expected = text;
    std::erase(expected, ' ');
    EXPECT_EQ(all, expected) << columns;
  }
}

TEST(TerminalColumnsTest, AreThoseOfTheTerminal) {
  const int terminal = posix_openpt(O_RDWR | O_NOCTTY);
  ASSERT_GE(terminal, 0);
  const winsize size = {.ws_row = 24, .ws_col = 80, .ws_xpixel = 0, .ws_ypixel = 0};
  ASSERT_EQ(ioctl(terminal, TIOCSWINSZ, &size), 0);
  EXPECT_EQ(TerminalColumns(terminal), 80u);
  close(terminal);
}

TEST(TerminalColumnsTest, AFileIsNoTerminal) {
  EXPECT_EQ(TerminalColumns(-1), 0u);
  EXPECT_EQ(TerminalColumns(1'000'000), 0u);
}

TEST(ShellWordTest, AServerWritesNoCommand) {
  EXPECT_EQ(ShellWord("r1"), "r1");
  EXPECT_EQ(ShellWord("sha256:0a/b.c"), "sha256:0a/b.c");
  EXPECT_EQ(ShellWord(""), "''");
  EXPECT_EQ(ShellWord("--out"), "'--out'");
  EXPECT_EQ(ShellWord("$(reboot)"), "'$(reboot)'");
  EXPECT_EQ(ShellWord("a\nb"), "'a\\x0ab'");
  EXPECT_EQ(ShellWord("a';reboot #"), "'a'\\'';reboot #'");
}

}  // namespace
}  // namespace rips::ripsctl
