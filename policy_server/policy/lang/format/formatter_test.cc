#include "policy_server/policy/lang/format/formatter.h"

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/lang/limits.h"
#include "policy_server/policy/lang/syntax/ast_printer.h"
#include "policy_server/policy/lang/syntax/lexer.h"
#include "policy_server/policy/lang/syntax/parser.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

// What must be the same before and after: the tokens, the tree, the comments.
struct Meaning {
  std::vector<std::string> tokens;
  std::vector<std::string> comments;
  std::string tree;

  friend bool operator==(const Meaning&, const Meaning&) = default;
};

Meaning MeaningOf(const std::string& text) {
  const Source source(0, text);
  DiagnosticSink sink;
  const std::vector<Token> tokens = Lex(source, sink);
  Meaning out;
  size_t at = source.start();
  for (const Token& token : tokens) {
    const std::string gap = text.substr(at, token.offset - at);
    for (size_t hash = gap.find('#'); hash != std::string::npos; hash = gap.find('#', hash)) {
      const size_t end = std::min(gap.find('\n', hash), gap.size());
      out.comments.emplace_back(absl::StripTrailingAsciiWhitespace(gap.substr(hash, end - hash)));
      hash = end;
    }
    out.tokens.push_back(text.substr(token.offset, token.length));
    at = token.end();
  }
  out.tree = Print(Parse(source, tokens, sink));
  EXPECT_FALSE(sink.has_errors()) << text;
  return out;
}

// Formats, and looks after what holds for every file.
std::string Formatted(const std::string& text) {
  const FormatResult result = Format({.path = "a.rul", .text = text});
  if (!result.text.has_value()) {
    return absl::StrCat("refused: ", RenderText({{"a.rul", text}}, result.diagnostics));
  }
  EXPECT_THAT(result.diagnostics, IsEmpty());
  const Meaning before = MeaningOf(text);
  const Meaning after = MeaningOf(*result.text);
  EXPECT_EQ(before.tokens, after.tokens) << text;
  EXPECT_EQ(before.comments, after.comments) << text;
  EXPECT_EQ(before.tree, after.tree) << text;
  EXPECT_EQ(Format({.path = "a.rul", .text = *result.text}).text, result.text) << text;
  return *result.text;
}

std::string ReadAll(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

TEST(FormatterTest, SpacesAndIndents) {
  EXPECT_EQ(Formatted("levels:A;soft   B;\tC\nsoft ;consts:i int=0x10+- 1;s set string={\"a\" ,\n"
                      "\"b\"};vars:b bool=! ( true||false );rules  Msg :b?set(b,! b)=>alert( \"x\""
                      ")\n,trigger(A);n:b?{alert(\"x\",);}\"a name\":b?alert(\"y\")→trigger( B );"),
            R"(levels:
  A;
  soft B;
  C soft;

consts:
  i int = 0x10 + -1;
  s set string = {"a", "b"};

vars:
  b bool = !(true || false);

rules Msg:
  b ? set(b, !b) => alert("x"), trigger(A);
  n: b ? {
    alert("x",);
  }
  "a name": b ? alert("y") → trigger(B);
)");
}

TEST(FormatterTest, LeavesTheExampleAlone) {
  const std::filesystem::path rules = std::filesystem::path(RIPS_SOURCE_DIR) / "rules";
  int files = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(rules)) {
    if (entry.path().extension() != ".rul") continue;
    const std::string text = ReadAll(entry.path());
    EXPECT_EQ(Formatted(text), text) << entry.path();
    ++files;
  }
  EXPECT_GT(files, 0);
}

TEST(FormatterTest, AgreesWithEveryGoldenFileThatParses) {
  const std::filesystem::path golden = std::filesystem::path(RIPS_SOURCE_DIR) / "tests/golden";
  int formatted = 0;
  for (const auto& entry : std::filesystem::directory_iterator(golden)) {
    if (entry.path().extension() != ".rul") continue;
    const std::string text = ReadAll(entry.path());
    if (Format({.path = "a.rul", .text = text}).text) {
      Formatted(text);
      ++formatted;
    }
  }
  EXPECT_GE(formatted, 5);
}

TEST(FormatterTest, BreaksARuleThatDoesNotFit) {
  EXPECT_EQ(Formatted("rules Msg: driver: topicin(\"/cmd_vel\") && !publishers(\"/navigator\") ? "
                      "set(rogue, true) => trigger(COMPROMISED);"),
            R"(rules Msg:
  driver:
    topicin("/cmd_vel") && !publishers("/navigator") ? set(rogue, true) => trigger(COMPROMISED);
)");
  EXPECT_EQ(Formatted("rules Msg: topicin(\"/cmd_vel\") && !publishers(\"/navigator\") && "
                      "!rogue ? set(rogue, true) => trigger(COMPROMISED);"),
            R"(rules Msg:
  topicin("/cmd_vel") && !publishers("/navigator") && !rogue ?
    set(rogue, true) => trigger(COMPROMISED);
)");
  EXPECT_EQ(Formatted("rules Msg: driver: topicin(\"/cmd_vel\") && !publishers(\"/navigator\") && "
                      "!rogue && steering ? { set(rogue, true) => trigger(HALT); alert(\"x\"); }"),
            R"(rules Msg:
  driver: topicin("/cmd_vel") && !publishers("/navigator") && !rogue && steering ? {
    set(rogue, true) => trigger(HALT);
    alert("x");
  }
)");
  const std::string name(80, 'n');
  EXPECT_EQ(Formatted(absl::StrCat("rules Msg: ", name, ": aaaaaaaaaaaaaa ? { a(); }")),
            absl::StrCat("rules Msg:\n  ", name, ":\n    aaaaaaaaaaaaaa ? {\n      a();\n    }\n"));
}

TEST(FormatterTest, KeepsTheBreaksOfTheAuthorAfterNameAndQuestionMark) {
  const std::string text = R"(rules Msg:
  name:
    a ? b();

  name:
    a ?
      b();

  a ?
    b();
)";
  EXPECT_EQ(Formatted(text), text);
  EXPECT_EQ(Formatted("rules Msg: name: a ?\nb();"), "rules Msg:\n  name:\n    a ?\n      b();\n");
  EXPECT_EQ(Formatted("rules Msg: name\n: a\n? b(\n)\n;"), "rules Msg:\n  name: a ? b();\n");
  EXPECT_EQ(Formatted("rules Msg: a ?\n\n{ b(); }"), "rules Msg:\n  a ? {\n    b();\n  }\n");
}

TEST(FormatterTest, BreaksConditionsBeforeTheLoosestOperator) {
  const std::string a = absl::StrCat("aaaaaa(\"", std::string(40, 'a'), "\")");
  const std::string b = absl::StrCat("bbbbbb(\"", std::string(40, 'b'), "\")");
  EXPECT_EQ(Formatted(absl::StrCat("rules Msg: ", a, " && x == 1 || ", b, " ? y();")),
            absl::StrCat("rules Msg:\n  ", a, " && x == 1\n  || ", b, " ?\n    y();\n"));
  EXPECT_EQ(Formatted(absl::StrCat("rules Msg: ", a, " && !(", a, " || ", b, ") || ", b, "&&", a,
                                   "?y();")),
            absl::StrCat("rules Msg:\n",             //
                         "  ", a, "\n",              //
                         "     && !(", a, "\n",      //
                         "          || ", b, ")\n",  //
                         "  || ", b, "\n",           //
                         "     && ", a, " ?\n    y();\n"));
}

TEST(FormatterTest, BreaksChainsBeforeConnectors) {
  const std::string a(40, 'a');
  const std::string b(60, 'b');
  EXPECT_EQ(Formatted(absl::StrCat("rules Msg: x ? set(rogue, true) => alert(\"", a,
                                   "\") !> trigger(COMPROMISED), exec(\"x\");")),
            absl::StrCat("rules Msg:\n  x ?\n    set(rogue, true) => alert(\"", a,
                         "\")\n                     !> trigger(COMPROMISED)\n"
                         "                     , exec(\"x\");\n"));
  EXPECT_EQ(Formatted(absl::StrCat("rules Msg: x ? alert(\"", b, "\") → alert(\"", b, "\"), y();")),
            absl::StrCat("rules Msg:\n  x ?\n    alert(\"", b, "\")\n      → alert(\"", b,
                         "\")\n      , y();\n"));
}

TEST(FormatterTest, BreaksListsAfterCommas) {
  const std::string a(40, 'a');
  const std::string b(60, 'b');
  EXPECT_EQ(Formatted(absl::StrCat("consts: s set string = {\"", a, "\", \"", b, "\"};")),
            absl::StrCat("consts:\n  s set string = {\n    \"", a, "\",\n    \"", b, "\"\n  };\n"));
  EXPECT_EQ(Formatted(absl::StrCat("rules Msg: x ? alert(\"", a, "\" + \"", b, "\", \"high\");")),
            absl::StrCat("rules Msg:\n  x ?\n    alert(\"", a, "\"\n          + \"", b,
                         "\",\n          \"high\");\n"));
  EXPECT_EQ(Formatted(absl::StrCat("vars: s string = \"", a, "\" + \"", b, "\";")),
            absl::StrCat("vars:\n  s string = \"", a, "\"\n      + \"", b, "\";\n"));
  // No room under the bracket.
  const std::string name(50, 'n');
  EXPECT_EQ(Formatted(absl::StrCat("rules Msg: x ? ", name, "(\"", a, "\", \"", a, "\");")),
            absl::StrCat("rules Msg:\n  x ?\n    ", name, "(\n        \"", a, "\",\n        \"", a,
                         "\");\n"));
}

TEST(FormatterTest, KeepsCommentsWhereTheyBelong) {
  const std::string text = R"(#!/usr/bin/env -S ripsctl rules check
# About the file.

# About the levels.
levels:  # trailing the keyword
  # About A.
  A;        # trailing A
  BB soft;  # trailing BB
            # and more of it
  # A note at the end of the section.

consts:
  # Free.

  s set string = {
    "/a",  # one
    # Before b.
    "/b"
    # After b.
  };

  # rule_that_sleeps:
  #   x ? y();

# About the rules.
rules Msg:
  # About r.
  r:
    a  # why a
    # Before the operator.
    && b ?  # why b
      c()   # why c
        # Before the connector.
        => d();

  # About braces.
  x ? {  # open
    # About the first chain.
    a();

    b();  # trailing b
    # At the end.
  }  # closed
  # The last words of the section.

# The last words of the file.
)";
  EXPECT_EQ(Formatted(text), text);
}

TEST(FormatterTest, PutsCommentsIntoTheirPlace) {
  EXPECT_EQ(Formatted("\n\n   # first   \n levels: # k\r\n A; B; # b\n\n\n\n # c\n   # d\nvars:\n\n"
                      "\n# e\n x int = 1;\n  # f\n# g\n  # h\n\n\n"),
            R"(# first
levels:  # k
  A;
  B;  # b

# c
# d
vars:
  # e
  x int = 1;
  # f
# g
# h
)");
}

TEST(FormatterTest, TakesACommentBetweenAnyTwoTokens) {
  const std::string text =
      "levels:A;soft B;C soft;consts:s set string={\"a\",\"b\"};vars:i int=-(1+2)*3;"
      "rules Msg:n:f(s,1,)&&!(i==0||g())?a()=>b(1),c();\"x\":h?{a();b()!>c();}h?a();";
  const Source source(0, text);
  DiagnosticSink sink;
  const std::vector<Token> tokens = Lex(source, sink);
  for (const std::string comment : {"# c\n", "\n# c\n", "\n\n  # c\n\n", "# c\n# d\n", "\n"}) {
    std::string everywhere = comment;
    for (const Token& token : tokens) {
      Formatted(absl::StrCat(text.substr(0, token.offset), comment, text.substr(token.offset)));
      absl::StrAppend(&everywhere, text.substr(token.offset, token.length), comment);
    }
    Formatted(everywhere);
  }
}

TEST(FormatterTest, AlignsNeighbouringCommentsOnlyWhereTheyFit) {
  const std::string name(60, 'n');
  const std::string comment = absl::StrCat("# ", std::string(50, 'c'));
  EXPECT_EQ(Formatted(absl::StrCat("levels: A;", comment, "\n", name, "; # x\n")),
            absl::StrCat("levels:\n  A;  ", comment, "\n  ", name, ";  # x\n"));
}

TEST(FormatterTest, KeepsStringsAsTheyAre) {
  EXPECT_EQ(
      Formatted("rules Msg: x ? alert(\"one  \n\ttwo # no comment\r\n\\\" three\" ,  \"high\" );"),
      "rules Msg:\n  x ? alert(\"one  \n\ttwo # no comment\r\n\\\" three\", \"high\");\n");
}

TEST(FormatterTest, CountsColumnsInCodePoints) {
  std::string word;
  for (int i = 0; i < 85; ++i) word += "é";
  const std::string text = absl::StrCat("rules Msg:\n  x ? a(\"", word, "\");\n");
  EXPECT_EQ(Formatted(text), text);
}

TEST(FormatterTest, KeepsLinesToTheLimit) {
  for (int width = 60; width < 120; ++width) {
    const std::string word(width, 'w');
    for (const std::string& rule :
         {absl::StrCat("x ? ", word, "();"), absl::StrCat("x && ", word, " ? y();"),
          absl::StrCat("n: x && ", word, " ? {y();}"), absl::StrCat("x ? y() => ", word, "(1);")}) {
      for (absl::string_view line : absl::StrSplit(Formatted("rules Msg:" + rule), '\n')) {
        EXPECT_TRUE(CountCodePoints(line) <= 100 || width > 85) << line;
      }
    }
  }
}

TEST(FormatterTest, TakesFilesWithoutRules) {
  EXPECT_EQ(Formatted(""), "");
  EXPECT_EQ(Formatted(" \r\n\t\n"), "");
  EXPECT_EQ(Formatted("\xEF\xBB\xBF"), "");
  EXPECT_EQ(Formatted("  # only\n\n\n  # comments"), "# only\n\n# comments\n");
  EXPECT_EQ(Formatted("\xEF\xBB\xBFrules Msg:rules Graph:\n\n\n"), "rules Msg:\n\nrules Graph:\n");
}

TEST(FormatterTest, DoesNotCareWhatNamesMean) {
  EXPECT_EQ(Formatted("rules Nothing:unknown+1?unknown();"),
            "rules Nothing:\n  unknown + 1 ? unknown();\n");
}

TEST(FormatterTest, RefusesWhatDoesNotParse) {
  const FormatResult result =
      Format({.path = "a.rul", .text = "rules Msg:\n  a = 1 ? b();\n  \xC2\xA7 ? b(;\n"});
  EXPECT_EQ(result.text, std::nullopt);
  EXPECT_THAT(
      RenderText({{"a.rul", "rules Msg:\n  a = 1 ? b();\n  \xC2\xA7 ? b(;\n"}}, result.diagnostics),
      testing::AllOf(HasSubstr("a.rul:2:5: error: expected `?`"),
                     HasSubstr("a.rul:3:3: error: unexpected character")));
  EXPECT_THAT(Formatted("rules Msg: \xFF"), HasSubstr("not UTF-8 at byte offset 11"));
  EXPECT_THAT(Formatted("rules Msg: \"x"), HasSubstr("never ends"));
}

TEST(FormatterTest, EveryPrefixIsFormattedOrRefused) {
  const std::string text =
      ReadAll(std::filesystem::path(RIPS_SOURCE_DIR) / "rules/warehouse/warehouse.rul");
  for (size_t length = 0; length < text.size(); length += 3) {
    const FormatResult result = Format({.path = "a.rul", .text = text.substr(0, length)});
    EXPECT_NE(result.text.has_value(), !result.diagnostics.empty()) << length;
  }
}

TEST(FormatterTest, LimitsDiagnostics) {
  std::string text = "rules Msg:\n";
  for (int i = 0; i < 60; ++i) text += "1 2;\n";
  const FormatResult result = Format({.path = "a.rul", .text = text});
  EXPECT_EQ(result.text, std::nullopt);
  ASSERT_THAT(result.diagnostics, SizeIs(51));
  EXPECT_EQ(result.diagnostics[50].kind, DiagnosticKind::kTooManyDiagnostics);
}

TEST(FormatterTest, LimitsTheSizeBeforeAndAfter) {
  EXPECT_THAT(Formatted(std::string(kFileBytesMax + 1, ' ')),
              HasSubstr("a file of 1048577 bytes exceeds limit 1048576"));
  EXPECT_EQ(Formatted(std::string(kFileBytesMax, ' ')), "");
  std::string text = "levels:";
  for (int i = 0; i < 210'000; ++i) text += "A;";
  EXPECT_THAT(
      Formatted(text),
      HasSubstr("formatted, the file would have 1050008 bytes; this exceeds limit 1048576"));
}

TEST(FormatterTest, TakesDeepNestingAndLongRuns) {
  std::string deep = "rules Msg: ";
  for (int i = 0; i < kNestingMax; ++i) deep += i % 2 == 0 ? "!" : "(a && ";
  deep += "a";
  for (int i = 1; i < kNestingMax; i += 2) deep += ")";
  const std::string nested = Formatted(deep + " ? b();");
  EXPECT_LT(nested.size(), 100 * deep.size());

  std::string run = "rules Msg: x";
  for (int i = 0; i < 50'000; ++i) run += " || x";
  EXPECT_THAT(Formatted(run + " ? b();"), HasSubstr("\n  || x\n  || x"));
}

}  // namespace
}  // namespace rips::lang
