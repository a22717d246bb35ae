#include "policy_server/policy/lang/syntax/parser.h"

#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/lang/syntax/ast_printer.h"
#include "policy_server/policy/lang/syntax/lexer.h"
#include "policy_server/policy/lang/syntax/operators.h"

namespace rips::lang {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

struct Parsed {
  ast::File file;
  size_t tokens = 0;
  // "line:col message".
  std::vector<std::string> errors;
};

Parsed ParseText(absl::string_view text) {
  const Source source(0, text);
  DiagnosticSink sink;
  const std::vector<Token> tokens = Lex(source, sink);
  Parsed out;
  out.file = Parse(source, tokens, sink);
  out.tokens = tokens.size() - 1;
  for (const Diagnostic& d : sink.diagnostics()) {
    const Position at = source.PositionOf(d.range.offset);
    out.errors.push_back(absl::StrCat(at.line, ":", at.column, " ", d.message));
  }
  return out;
}

std::string Rule(absl::string_view expr) { return absl::StrCat("rules Msg: ", expr, " ? a();"); }

// The expression with every operation in brackets.
std::string Grouped(const ast::Expr& expr) {
  if (expr.kind == ast::Expr::Kind::kUnary) {
    return absl::StrCat("[", Spelling(expr.unary), Grouped(expr.operands[0]), "]");
  }
  if (expr.kind != ast::Expr::Kind::kRun) return Print(expr);
  std::string out = Grouped(expr.operands[0]);
  for (size_t i = 0; i < expr.operators.size(); ++i) {
    out =
        absl::StrCat("[", out, Spelling(expr.operators[i].op), Grouped(expr.operands[i + 1]), "]");
  }
  return out;
}

std::string GroupedText(absl::string_view expr) {
  const Parsed parsed = ParseText(Rule(expr));
  if (!parsed.errors.empty()) return parsed.errors[0];
  return Grouped(*parsed.file.sections[0].rules[0].condition);
}

constexpr absl::string_view kGood =
    "levels : DEFAULT ; ALERT soft ; soft TENSE ; HALT ; "
    "consts : S set string = { \"a\" , \"b\" + \"c\" } ; i int = - 9223372036854775808 ; "
    "vars : f float = 1.5 ; b bool = true ; "
    "rules Msg : topicin ( S , ) && ! ( b == false ) ? alert ( \"x\\n\" ) => exec ( \"p\" ) !> "
    "trigger ( HALT ) , set ( f , f * 2.0 ) ; "
    "named : 1 + 2 * 3 << 4 ? { alert ( \"a\" ) ; alert ( \"b\" ) ; } "
    "\"a name\" : x ( ) ? a ( ) ; rules Graph : rules External : true ? crash ( \"x\" ) ;";

std::string Good() { return absl::StrReplaceAll(kGood, {{"<<", "<"}}); }

TEST(ParserTest, GroupsByPrecedenceAndToTheLeft) {
  EXPECT_EQ(GroupedText("a || b && c | d ^ e & f == g < h + i * j"),
            "[a||[b&&[c|[d^[e&[f==[g<[h+[i*j]]]]]]]]]");
  EXPECT_EQ(GroupedText("a * b + c < d == e & f ^ g | h && i || j"),
            "[[[[[[[[[a*b]+c]<d]==e]&f]^g]|h]&&i]||j]");
  EXPECT_EQ(GroupedText("a - b - c + d"), "[[[a-b]-c]+d]");
  EXPECT_EQ(GroupedText("a == b != c"), "[[a==b]!=c]");
  EXPECT_EQ(GroupedText("!a && -b < ~c"), "[[!a]&&[[-b]<[~c]]]");
  EXPECT_EQ(GroupedText("- ! ~ + a"), "[-[![~[+a]]]]");
  EXPECT_EQ(GroupedText("-a * b"), "[[-a]*b]");
}

TEST(ParserTest, UnderstandsEveryTokenOfAGoodFile) {
  const Parsed parsed = ParseText(Good());
  EXPECT_THAT(parsed.errors, IsEmpty());
  EXPECT_EQ(parsed.file.understood, parsed.tokens);
  ASSERT_EQ(parsed.file.sections.size(), 6u);
  EXPECT_EQ(parsed.file.sections[3].rules.size(), 3u);
  EXPECT_EQ(parsed.file.sections[3].rules[1].chains.size(), 2u);
}

TEST(ParserTest, ReadsTheSameThroughAnyWhiteSpace) {
  const std::string plain = Print(ParseText(Good()).file);
  for (const absl::string_view space : {"\n", "\t\t", "\r\n", " # ; } rules\n"}) {
    const std::string text = absl::StrReplaceAll(Good(), {{" ", space}});
    // White space inside a string is part of it.
    const std::string expected = absl::StrReplaceAll(plain, {{"\"a name\"", "NAME"}});
    const Parsed parsed =
        ParseText(absl::StrReplaceAll(text, {{absl::StrCat("a", space, "name"), "a name"}}));
    EXPECT_THAT(parsed.errors, IsEmpty()) << space;
    EXPECT_EQ(absl::StrReplaceAll(Print(parsed.file), {{"\"a name\"", "NAME"}}), expected);
  }
}

TEST(ParserTest, PrintsWhatItParses) {
  const std::string once = Print(ParseText(Good()).file);
  const Parsed again = ParseText(once);
  EXPECT_THAT(again.errors, IsEmpty()) << once;
  EXPECT_EQ(Print(again.file), once);
  EXPECT_THAT(once, testing::HasSubstr("soft;"));
}

TEST(ParserTest, EveryPrefixEitherParsesOrIsReported) {
  const std::string good = Good();
  for (size_t size = 0; size < good.size(); ++size) {
    const Parsed parsed = ParseText(good.substr(0, size));
    EXPECT_TRUE(!parsed.errors.empty() || parsed.file.understood == parsed.tokens) << size;
  }
}

TEST(ParserTest, AStrayByteAnywhereIsAnError) {
  const std::string good = Good();
  bool in_string = false;
  for (size_t at = 0; at < good.size(); ++at) {
    const bool inside = in_string;
    if (good[at] == '"') in_string = !in_string;
    if (inside) continue;
    std::string text = good;
    text.insert(at, "$");
    EXPECT_FALSE(ParseText(text).errors.empty()) << text.substr(at);
  }
}

TEST(ParserTest, GoesOnAfterMistakes) {
  const Parsed parsed = ParseText(
      "levels: A B; C;\n"
      "vars: x = 1; y int = 2 3; S set string = {1;};\n"
      "rules Msg:\n"
      "  topicin(\"a\" \"b\") ? alert(1;\n"
      "  true alert(); x ? { a() b(); c(; d() }\n"
      "  x ? a() => ; ? b();\n"
      "  x = 1 ? a();\n");
  EXPECT_THAT(
      parsed.errors,
      ElementsAre("1:11 expected `;` after the level, found `B`",
                  "2:9 expected a type (`int`, `float`, `bool`, `string`), found `=`",
                  "2:24 expected `;` after the declaration, found `3`",
                  "2:44 expected `}` after the members of the set, found `;`",
                  "4:15 expected `)` or `,` after an argument, found a string",
                  "4:29 expected `)` or `,` after an argument, found `;`",
                  "5:8 expected `?` after the expression of a rule, found `alert`",
                  "5:27 expected `;` or a connector (`=>`, `!>`, `,`) after the action, found `b`",
                  "5:34 expected an expression, found `;`",
                  "5:40 expected `;` or a connector (`=>`, `!>`, `,`) after the action, found `}`",
                  "6:14 expected an action, found `;`", "6:16 expected an expression, found `?`",
                  "7:5 expected `?` after the expression of a rule, found `=`"));
}

TEST(ParserTest, ReportsTheEndOfTheFileBehindTheLastToken) {
  EXPECT_THAT(ParseText("levels: A\n\n\n").errors,
              ElementsAre("1:10 expected `;` after the level, found the end of the file"));
}

TEST(ParserTest, WantsAMinusBeforeTheSmallestInteger) {
  EXPECT_THAT(ParseText(Rule("-9223372036854775808 == -0x8000000000000000")).errors, IsEmpty());
  EXPECT_THAT(ParseText(Rule("9223372036854775808")).errors,
              ElementsAre("1:12 number `9223372036854775808` is out of range"));
  EXPECT_THAT(ParseText(Rule("-(9223372036854775808)")).errors,
              ElementsAre("1:14 number `9223372036854775808` is out of range"));
}

TEST(ParserTest, LimitsNesting) {
  const auto nest = [](absl::string_view open, absl::string_view close, int depth) {
    std::string text;
    for (int i = 0; i < depth; ++i) absl::StrAppend(&text, open);
    absl::StrAppend(&text, "x");
    for (int i = 0; i < depth; ++i) absl::StrAppend(&text, close);
    return Rule(text);
  };
  for (const auto& [open, close] : std::vector<std::pair<std::string, std::string>>{
           {"(", ")"}, {"!", ""}, {"f(", ")"}, {"1||1&&1|1^1&1==1<1+1*(", ")"}}) {
    EXPECT_THAT(ParseText(nest(open, close, kNestingMax)).errors, IsEmpty()) << open;
    const Parsed deep = ParseText(nest(open, close, kNestingMax + 1));
    ASSERT_EQ(deep.errors.size(), 1u) << open;
    EXPECT_THAT(deep.errors[0], testing::HasSubstr("nesting depth 257 exceeds limit 256"));
    EXPECT_EQ(ParseText(nest(open, close, 20000)).errors.size(), 1u) << open;
  }
}

TEST(ParserTest, TakesLongRunsFlat) {
  std::string text = "x";
  for (int i = 0; i < 100000; ++i) text += " || x";
  const Parsed parsed = ParseText(Rule(text));
  EXPECT_THAT(parsed.errors, IsEmpty());
  EXPECT_EQ(parsed.file.sections[0].rules[0].condition->operands.size(), 100001u);
}

}  // namespace
}  // namespace rips::lang
