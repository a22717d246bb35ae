// Source, UTF-8, literals and values as text.
#include <cmath>
#include <cstdlib>
#include <limits>
#include <random>
#include <string>

#include "gtest/gtest.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/syntax/literal.h"
#include "policy_server/policy/lang/value_text.h"
#include "services/text/nearest.h"
#include "services/text/quote.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

TEST(SourceTest, CountsColumnsInCodePoints) {
  const Source source(0,
                      "aé→\xFF"
                      "b\r\nxy");

  EXPECT_EQ(source.PositionOf(0), (Position{1, 1}));
  EXPECT_EQ(source.PositionOf(1), (Position{1, 2}));
  EXPECT_EQ(source.PositionOf(3), (Position{1, 3}));
  EXPECT_EQ(source.PositionOf(6), (Position{1, 4}));
  EXPECT_EQ(source.PositionOf(7), (Position{1, 5}));
  EXPECT_EQ(source.PositionOf(10), (Position{2, 1}));
  EXPECT_EQ(source.PositionOf(1000), (Position{2, 3}));
  EXPECT_EQ(source.Line(1),
            "aé→\xFF"
            "b");
  EXPECT_EQ(source.Line(2), "xy");
  EXPECT_EQ(source.Line(3), "");
  EXPECT_EQ(source.Line(0), "");
}

TEST(SourceTest, GivesTheByteOrderMarkNoColumn) {
  const Source source(0,
                      "\xEF\xBB\xBF"
                      "ab");
  EXPECT_EQ(source.PositionOf(0), (Position{1, 1}));
  EXPECT_EQ(source.PositionOf(4), (Position{1, 2}));
  EXPECT_EQ(source.Line(1), "ab");
}

TEST(Utf8Test, FindsTheFirstBadByte) {
  EXPECT_EQ(FindInvalidUtf8("aé→\U0001F916"), std::nullopt);
  EXPECT_EQ(FindInvalidUtf8("a\x80"), 1);
  EXPECT_EQ(FindInvalidUtf8("\xC0\x80"), 0);          // Overlong.
  EXPECT_EQ(FindInvalidUtf8("\xED\xA0\x80"), 0);      // Surrogate.
  EXPECT_EQ(FindInvalidUtf8("\xF4\x90\x80\x80"), 0);  // Beyond 10FFFF.
  EXPECT_EQ(FindInvalidUtf8("ab\xE2\x86"), 2);        // Cut.
}

TEST(Utf8Test, RoundTripsEveryLength) {
  for (const char32_t value : {0x24u, 0x7Fu, 0x80u, 0x7FFu, 0x800u, 0xFFFFu, 0x10000u, 0x10FFFFu}) {
    std::string text;
    AppendUtf8(value, &text);
    const CodePoint point = DecodeCodePoint(text, 0);
    EXPECT_TRUE(point.valid);
    EXPECT_EQ(point.value, value);
    EXPECT_EQ(point.length, text.size());
  }
}

TEST(Utf8Test, CutsAtCodePoints) {
  EXPECT_EQ(CutCodePoints("", 0), "");
  EXPECT_EQ(CutCodePoints("abc", 3), "abc");
  EXPECT_EQ(CutCodePoints("abc", 2), "ab");
  EXPECT_EQ(CutCodePoints("äöü", 2), "äö");
  EXPECT_EQ(CutCodePoints("äöü", 3), "äöü");
  EXPECT_EQ(CutCodePoints("→↛x", 1), "→");
  EXPECT_EQ(CutCodePoints("😀😀", 1), "😀");
}

TEST(Utf8Test, CutsBrokenBytesOneByOne) {
  // A lone continuation, a start without its rest, an overlong form, a surrogate, above 10FFFF.
  for (const char* broken : {"\x80", "\xC3", "\xC0\x80", "\xE0\x80\x80", "\xED\xA0\x80",
                             "\xF4\x90\x80\x80", "\xF5\x80\x80\x80", "\xFF"}) {
    const std::string text = std::string(broken) + "z";
    EXPECT_EQ(CutCodePoints(text, 1), absl::string_view(broken, 1)) << text;
    EXPECT_EQ(CutCodePoints(text, text.size()), text);
    EXPECT_EQ(CutCodePoints(text, text.size() - 1).size(), text.size() - 1);
  }
}

TEST(Utf8Test, QuotesHostileText) {
  EXPECT_EQ(Quote("a\x1B[31m\xFF"), "`a\uFFFD[31m\uFFFD`");
  EXPECT_EQ(Quote(std::string(100, 'x')), "`" + std::string(64, 'x') + "...`");
}

TEST(LiteralTest, DecodesEveryEscape) {
  EXPECT_EQ(DecodeString(R"("\a\b\f\n\r\t\v\\\"\x41\101\u00e9\U0001F916")").value,
            "\a\b\f\n\r\t\v\\\"AAé\U0001F916");
  EXPECT_EQ(DecodeString(R"("\xff\377\000")").value, std::string("\xFF\xFF\0", 3));
}

TEST(LiteralTest, EncodesWhatItDecodes) {
  std::string all;
  for (int byte = 0; byte < 256; ++byte) all.push_back(static_cast<char>(byte));
  for (const std::string& value : {all, std::string("aé→\U0001F916"), std::string()}) {
    const StringValue decoded = DecodeString(EncodeString(value));
    EXPECT_EQ(decoded.value, value);
    EXPECT_EQ(decoded.bad_escape, "");
  }
}

TEST(LiteralTest, DecodesIntegersToTheLimit) {
  EXPECT_EQ(DecodeInteger("0xfF").magnitude, 255u);
  EXPECT_EQ(DecodeInteger("0o17").magnitude, 15u);
  EXPECT_EQ(DecodeInteger("0b101").magnitude, 5u);
  EXPECT_EQ(DecodeInteger("017").magnitude, 17u);
  EXPECT_EQ(DecodeInteger("9223372036854775808").magnitude, kMinIntMagnitude);
  EXPECT_EQ(DecodeInteger("9223372036854775808").error, std::nullopt);
  EXPECT_EQ(DecodeInteger("9223372036854775809").error, NumberError::kOutOfRange);
}

TEST(ValueTextTest, WritesFloatsShortest) {
  const struct {
    double value;
    const char* text;
  } kCases[] = {
      {0, "0"},
      {-0.0, "-0"},
      {1, "1"},
      {-2.5, "-2.5"},
      {0.1, "0.1"},
      {0.1 + 0.2, "0.30000000000000004"},
      {100, "100"},
      {0.0001, "0.0001"},
      {0.00012, "0.00012"},
      {0.00009, "9e-05"},
      {0.00001, "1e-05"},
      {1.5e-7, "1.5e-07"},
      {-1.25e22, "-1.25e+22"},
      {1e20, "100000000000000000000"},
      {1e21, "1e+21"},
      {123456789012345678., "123456789012345680"},
      {1.02e-3, "0.00102"},
      {5e-324, "5e-324"},
      {std::numeric_limits<double>::max(), "1.7976931348623157e+308"},
      {std::numeric_limits<double>::infinity(), "+Inf"},
      {-std::numeric_limits<double>::infinity(), "-Inf"},
      {std::nan(""), "NaN"},
  };
  for (const auto& test : kCases) EXPECT_EQ(FormatFloat(test.value), test.text);
}

TEST(ValueTextTest, FloatsReadBack) {
  std::mt19937_64 random(7);
  for (int i = 0; i < 10'000; ++i) {
    const double value =
        std::ldexp(static_cast<double>(random()), static_cast<int>(random() % 200) - 160);
    EXPECT_EQ(std::strtod(FormatFloat(value).c_str(), nullptr), value) << FormatFloat(value);
  }
}

TEST(ValueTextTest, WritesEveryType) {
  EXPECT_EQ(ToText(std::numeric_limits<int64_t>::min()), "-9223372036854775808");
  EXPECT_EQ(ToText(true), "true");
  EXPECT_EQ(ToText(false), "false");
  EXPECT_EQ(ToText(std::string("x")), "x");
  EXPECT_EQ(ToText(1.5), "1.5");
}

TEST(NearestTest, GuessesAtDistanceTwo) {
  EXPECT_EQ(Nearest("ALRET", {"DEFAULT", "ALERT"}), "ALERT");
  EXPECT_EQ(Nearest("exce", {"alert", "exec"}), "exec");
  EXPECT_EQ(Nearest("topicn", {"topics", "topicin"}), "topics");
  EXPECT_EQ(Nearest("nothing", {"alert"}), "");
  EXPECT_EQ(Nearest("x", {"y"}), "");
  EXPECT_EQ(EditDistance("abc", "abc", 2), 0);
  EXPECT_EQ(EditDistance("topic", "tpoic", 2), 1) << "a swap";
  EXPECT_EQ(EditDistance("abcd", "badc", 2), 2);
  EXPECT_EQ(EditDistance("abc", "abcdefg", 2), 3);
}

}  // namespace
}  // namespace rips::lang
