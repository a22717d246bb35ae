#include "policy_server/policy/lang/syntax/lexer.h"

#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::lang {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

struct Lexed {
  // "kind:text", without the end of the file.
  std::vector<std::string> tokens;
  // "offset Kind: message".
  std::vector<std::string> diagnostics;
};

Lexed LexText(absl::string_view text) {
  const Source source(0, text);
  DiagnosticSink sink;
  Lexed out;
  for (const Token& token : Lex(source, sink)) {
    if (token.kind == TokenKind::kEndOfFile) continue;
    out.tokens.push_back(
        absl::StrCat(Describe(token.kind), ":", text.substr(token.offset, token.length)));
  }
  for (const Diagnostic& d : sink.diagnostics()) {
    out.diagnostics.push_back(absl::StrCat(d.range.offset, " ", Name(d.kind), ": ", d.message));
  }
  return out;
}

// Tokens in order, end of file last, nothing but trivia between them.
void ExpectTiles(absl::string_view text) {
  const Source source(0, text);
  DiagnosticSink sink;
  const std::vector<Token> tokens = Lex(source, sink);
  ASSERT_FALSE(tokens.empty());
  EXPECT_EQ(tokens.back().kind, TokenKind::kEndOfFile);
  uint32_t at = source.start();
  size_t errors = 0;
  for (const Token& token : tokens) {
    ASSERT_GE(token.offset, at) << text;
    ASSERT_TRUE(IsTrivia(text.substr(at, token.offset - at))) << text;
    ASSERT_TRUE(token.length > 0 || token.kind == TokenKind::kEndOfFile);
    if (token.kind == TokenKind::kError) ++errors;
    at = token.end();
  }
  EXPECT_EQ(at, text.size());
  EXPECT_TRUE(errors == 0 || sink.has_errors()) << text;
}

constexpr absl::string_view kSample =
    "#!/usr/bin/env rips\nlevels: DEFAULT; soft ALERT;\r\nconsts:\tÑandú int = 0x1F; # é\n"
    "vars: s string = \"a\\\"b\\x41\\u00e9\n\"; f float = 1.02e-3;\n"
    "rules Msg: topicin(\"/a\") && !(1 <= 2) || .5 > 1. ? alert(\"→\") → a() ↛ b() => c() !> d();";

TEST(LexerTest, TakesTheLongestSymbol) {
  EXPECT_THAT(LexText("=>==!>!===<=<||||&&&").tokens,
              ElementsAre("`=>`:=>", "`==`:==", "`!>`:!>", "`!=`:!=", "`==`:==", "`<=`:<=", "`<`:<",
                          "`||`:||", "`||`:||", "`&&`:&&", "`&`:&"));
}

TEST(LexerTest, ReadsEveryKindOfNumber) {
  EXPECT_THAT(
      LexText("0 12 0x1fA 0o17 0b101 .01 1. 1E9 1.02e-3 1e+3 18.0").tokens,
      ElementsAre("an integer:0", "an integer:12", "an integer:0x1fA", "an integer:0o17",
                  "an integer:0b101", "a floating point number:.01", "a floating point number:1.",
                  "a floating point number:1E9", "a floating point number:1.02e-3",
                  "a floating point number:1e+3", "a floating point number:18.0"));
}

TEST(LexerTest, RefusesNumbersThatMeanNothing) {
  for (const absl::string_view text :
       {"0x", "0xg", "0b2", "0o8", "12ab", "1e", "1e+", "0X1F", "1_000", "1.5x", "0b", "3é"}) {
    EXPECT_THAT(LexText(text).diagnostics.size(), 1) << text;
    EXPECT_THAT(LexText(text).diagnostics.front(), testing::HasSubstr("MalformedNumber")) << text;
  }
}

TEST(LexerTest, ReportsNumbersOutOfRange) {
  EXPECT_THAT(LexText("9223372036854775808").diagnostics, IsEmpty());
  for (const absl::string_view text :
       {"9223372036854775809", "0x8000000000000001", "99999999999999999999999999", "1e999"}) {
    EXPECT_THAT(LexText(text).diagnostics, ElementsAre(absl::StrCat("0 NumberOutOfRange: number `",
                                                                    text, "` is out of range")));
  }
}

TEST(LexerTest, WarnsAboutLeadingZeros) {
  EXPECT_THAT(LexText("017").diagnostics, ElementsAre("0 LeadingZero: `017` is decimal"));
  EXPECT_THAT(LexText("0 0.5 0x0").diagnostics, IsEmpty());
}

TEST(LexerTest, KnowsKeywordsButNotTypeNames) {
  EXPECT_THAT(LexText("levels soft true int string set").tokens,
              ElementsAre("`levels`:levels", "`soft`:soft", "`true`:true", "a name:int",
                          "a name:string", "a name:set"));
}

TEST(LexerTest, TakesUnicodeLettersAndDigitsInNames) {
  EXPECT_THAT(LexText("niño_1 Ωx٣").tokens, ElementsAre("a name:niño_1", "a name:Ωx٣"));
  EXPECT_THAT(LexText("٣x").diagnostics.size(), 1);
}

TEST(LexerTest, PointsAtTheOpeningQuote) {
  EXPECT_THAT(LexText("  \"abc").diagnostics,
              ElementsAre("2 UnterminatedString: this string never ends"));
  EXPECT_THAT(
      LexText("  \"ab\\q\" \"\\ud800\" \"\\400\" \"\\07\" \"\\x4\" \"\\U00110000\"").diagnostics,
      ElementsAre("2 BadEscape: bad escape `\\q` in this string",
                  "9 BadEscape: bad escape `\\ud800` in this string",
                  "18 BadEscape: bad escape `\\400` in this string",
                  "25 BadEscape: bad escape `\\07` in this string",
                  "31 BadEscape: bad escape `\\x4` in this string",
                  "37 BadEscape: bad escape `\\U00110000` in this string"));
}

TEST(LexerTest, NamesWhatItCannotRead) {
  EXPECT_THAT(LexText("a @ \x01 \xFF '").diagnostics,
              ElementsAre("2 UnexpectedCharacter: unexpected character `@`",
                          "4 UnexpectedCharacter: unexpected character U+0001",
                          "6 UnexpectedCharacter: unexpected character byte 0xFF",
                          "8 UnexpectedCharacter: unexpected character `'`"));
}

TEST(LexerTest, LimitsNamesAndStrings) {
  const std::string name(kIdentifierBytesMax, 'a');
  EXPECT_THAT(LexText(name).diagnostics, IsEmpty());
  EXPECT_THAT(LexText(name + "a").diagnostics,
              ElementsAre("0 IdentifierTooLong: a name of 256 bytes exceeds limit 255"));

  std::string text = "\"";
  for (size_t i = 0; i < kStringCodePointsMax; ++i) text += "é";
  EXPECT_THAT(LexText(text + "\"").diagnostics, IsEmpty());
  EXPECT_THAT(LexText(text + "x\"").diagnostics,
              ElementsAre("0 StringTooLong: a string of 4097 code points exceeds limit 4096"));
}

TEST(LexerTest, TilesTheTextCutAtEveryByte) {
  for (size_t size = 0; size <= kSample.size(); ++size) {
    ASSERT_NO_FATAL_FAILURE(ExpectTiles(kSample.substr(0, size))) << size;
    ASSERT_NO_FATAL_FAILURE(ExpectTiles(kSample.substr(size))) << size;
  }
}

TEST(LexerTest, TilesTheTextWithEveryByteReplaced) {
  for (size_t at = 0; at < kSample.size(); ++at) {
    for (const char c : {'\0', '"', '\\', '\xFF', '\n', '#', '\xE2'}) {
      std::string text(kSample);
      text[at] = c;
      ASSERT_NO_FATAL_FAILURE(ExpectTiles(text)) << at;
    }
  }
}

TEST(LexerTest, ReadsTheSameThroughAnyWhiteSpace) {
  const Source source(0, kSample);
  DiagnosticSink sink;
  const Lexed plain = LexText(kSample);
  for (const absl::string_view space : {" ", "\n", "\t", "\r\n", " # note\n", "\v\f"}) {
    std::string text;
    for (const Token& token : Lex(source, sink)) {
      absl::StrAppend(&text, space, kSample.substr(token.offset, token.length));
    }
    EXPECT_EQ(LexText(text).tokens, plain.tokens) << "'" << space << "'";
  }
}

TEST(LexerTest, SkipsAByteOrderMarkOnlyAtTheStart) {
  EXPECT_THAT(LexText("\xEF\xBB\xBF"
                      "a")
                  .tokens,
              ElementsAre("a name:a"));
  EXPECT_THAT(LexText("a\xEF\xBB\xBF").diagnostics.size(), 1);
}

}  // namespace
}  // namespace rips::lang
