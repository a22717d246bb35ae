#include <string>
#include <thread>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/inspect/yara_rules.h"
#include "policy_server/policy/inspect/yara_scanner.h"
#include "policy_server/policy/inspect/yara_speed.h"
#include "services/base/status_matchers.h"

namespace rips::inspect {
namespace {

using engine::Verdict;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::Eq;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::SizeIs;
using ::testing::StartsWith;
using Kind = lang::InspectionProblem::Kind;

// A rule of one string, or of several.
std::string Rule(const std::string& strings, const std::string& condition = "any of them") {
  return absl::StrCat("rule r { strings: ", strings, " condition: ", condition, " }");
}

auto Problem(Kind kind, const std::string& message) {
  return AllOf(Field(&lang::InspectionProblem::kind, kind),
               Field(&lang::InspectionProblem::message, HasSubstr(message)));
}

auto Broken(const std::string& message) {
  return ElementsAre(Problem(Kind::kBroken, "x.yar" + message));
}
auto Slow(const std::string& message) {
  return ElementsAre(Problem(Kind::kSlow, "x.yar" + message));
}

std::vector<lang::InspectionProblem> Problems(const std::string& text) {
  YaraCompiled compiled = YaraRules::Compile(text, "x.yar");
  EXPECT_EQ(compiled.rules == nullptr, !compiled.problems.empty());
  return std::move(compiled.problems);
}

std::shared_ptr<const YaraRules> Compiled(const std::string& text) {
  const auto rules = YaraRules::Create(text, "x.yar");
  EXPECT_THAT(rules, IsOk());
  return rules.value_or(nullptr);
}

Verdict Scan(const std::string& text, absl::string_view payload) {
  const auto rules = Compiled(text);
  return rules == nullptr ? Verdict::kUnscanned
                          : YaraScanner(*rules).Scan(payload, absl::Seconds(10));
}

TEST(YaraRulesTest, ReportsEveryErrorWithItsLine) {
  EXPECT_THAT(Problems("rule a { condition: one }\n\nrule b { condition: two }\n"
                       "rule c { strings: $x = \"abcd\" condition: true }\n"),
              ElementsAre(Problem(Kind::kBroken, "x.yar:1: undefined identifier \"one\""),
                          Problem(Kind::kBroken, "x.yar:3: undefined identifier \"two\""),
                          Problem(Kind::kBroken, "x.yar:4: unreferenced string \"$x\"")));

  EXPECT_THAT(
      YaraRules::Create("rule a { condition: one }\nrule b { condition: two }", "y.yar"),
      StatusIs(absl::StatusCode::kInvalidArgument, Eq("y.yar:1: undefined identifier \"one\"\n"
                                                      "y.yar:2: undefined identifier \"two\"")));
}

TEST(YaraRulesTest, ReportsAtMostFiftyProblemsAndSaysSo) {
  std::string text;
  for (int i = 0; i < 60; ++i) absl::StrAppend(&text, "rule r", i, " { condition: nothing }\n");

  const std::vector<lang::InspectionProblem> problems = Problems(text);

  ASSERT_THAT(problems, SizeIs(kYaraProblemsMax + 1));
  EXPECT_THAT(problems.back(), Problem(Kind::kBroken, "10 more problems are not shown"));
}

TEST(YaraRulesTest, RefusesWhatIsNoRuleFile) {
  EXPECT_THAT(Problems(""), Broken(": no rule that could match"));
  EXPECT_THAT(Problems("// nothing\n"), Broken(": no rule that could match"));
  EXPECT_THAT(Problems("private rule p { condition: true }"),
              Broken(": no rule that could match; a private rule alone cannot"));
  EXPECT_THAT(Problems("\x7f\x45\x4c\x46\x02\x01"), SizeIs(testing::Ge(1u)));
  // libyara itself would stop at the NUL and accept what stands before it.
  EXPECT_THAT(Problems(std::string("rule a { condition: true }\0rubbish", 34)),
              Broken(": a NUL byte at offset 26"));
}

TEST(YaraRulesTest, MessagesHoldNothingUnprintable) {
  for (const auto& problem : Problems("rule a { condition: \x1b[31m\xff }")) {
    for (const char c : problem.message) EXPECT_TRUE(c >= ' ' && c <= '~') << problem.message;
  }
}

TEST(YaraRulesTest, RefusesIncludesAndImports) {
  EXPECT_THAT(Problems("rule a { condition: true }\ninclude \"/etc/passwd\"\n"),
              Broken(":2: `include` is not supported; put the rules into this file"));
  EXPECT_THAT(Problems("\nimport \"pe\"\nrule a { condition: true }"),
              Broken(":2: module `pe`: `import` is not supported"));
  EXPECT_THAT(Problems("rule b { condition: true } import \"math\"\n"
                       "rule a { condition: math.entropy(0, filesize) > 7 }"),
              Broken(": module `math`: `import` is not supported"));
  EXPECT_THAT(Problems("import \"none\"\nrule a { condition: true }"),
              Broken(":1: unknown module \"none\""));
  // The word alone is no import.
  EXPECT_EQ(Scan("/*\nimport \"pe\"\n*/ " + Rule("$a = \"import\""), "x import y"), Verdict::kYes);
}

TEST(YaraRulesTest, RefusesExternalVariables) {
  EXPECT_THAT(Problems("rule a { condition: filename == \"x\" }"),
              Broken(":1: undefined identifier \"filename\""));
}

TEST(YaraRulesTest, FileSizeIsLimited) {
  const std::string rule = Rule("$a = \"attack\"");
  const std::string longest = rule + std::string(kYaraFileBytesMax - rule.size(), ' ');

  EXPECT_THAT(Problems(longest), SizeIs(0));
  EXPECT_THAT(Problems(longest + " "), Broken(": 1048577 bytes exceed limit 1048576"));
}

TEST(YaraRulesTest, WarningsOfLibyaraAreSlow) {
  EXPECT_THAT(Problems("rule ok { condition: true }\n" + Rule("$a = \"a\"")),
              Slow(":2: string \"$a\" may slow down scanning"));
  EXPECT_THAT(Problems(Rule("$a = /.*foo/")), Slow(":1: $a contains .*, .+ or .{x,}"));
}

TEST(YaraRulesTest, PatternsThatSomePayloadMakesSlowAreRefused) {
  EXPECT_THAT(Problems(Rule("$a = /aaaa(a|b)*(a|c)*(a|d)*x/")), Slow(": slow: "));
  EXPECT_THAT(Problems(Rule("$a = /abcd.{0,500}b.{0,500}q/")), Slow(": slow: "));
#ifndef RIPS_SANITIZED  // the limit is higher then (kTrialCostFactor), and this lies below it
  EXPECT_THAT(Problems(Rule("$a = { 61 62 63 64 [0-190] 62 [0-190] 62 [0-190] 71 }")),
              Slow(": slow: "));
#endif
  EXPECT_THAT(Problems("rule r { condition: for all i in (0..100000000) : (uint8(i) >= 0) }"),
              Slow(": slow: scanning nothing takes more than 1 s"));
}

TEST(YaraRulesTest, NestingIsBounded) {
  const std::string deep(200'000, '(');
  EXPECT_THAT(Problems("rule r { condition: " + deep + "true }"), Broken(":1: "));
  EXPECT_THAT(Problems(Rule("$a = /abcd" + std::string(7000, '(') + "x/")),
              SizeIs(testing::Ge(1u)));
}

TEST(YaraRulesTest, TenThousandStringsCompileAndOneMoreInARuleIsRefused) {
  std::string strings;
  for (int i = 0; i < 10'000; ++i) {
    absl::StrAppend(&strings, "$s", i, " = \"string", i * 7919, "\" ");
  }

  EXPECT_EQ(Scan(Rule(strings), "some string79182081 here"), Verdict::kYes);
  EXPECT_THAT(Problems(Rule(strings + "$more = \"one more\"")),
              Broken(":1: too many strings in rule \"r\" (limit: 10000)"));
}

TEST(YaraScannerTest, TellsYesFromNo) {
  const std::string rule = Rule("$a = \"attack\" $b = { 00 01 ?? ff }");

  EXPECT_EQ(Scan(rule, "an attack!"), Verdict::kYes);
  EXPECT_EQ(Scan(rule, absl::string_view("x\0\1z\xff", 5)), Verdict::kYes);
  EXPECT_EQ(Scan(rule, "peace"), Verdict::kNo);
  EXPECT_EQ(Scan(rule, "a"), Verdict::kNo);
  EXPECT_EQ(Scan(rule, ""), Verdict::kNo);
  EXPECT_EQ(Scan("rule empty { condition: filesize == 0 }", ""), Verdict::kYes);
  EXPECT_EQ(
      Scan("private rule p { condition: true } rule r { condition: p and filesize > 3 }", "abc"),
      Verdict::kNo);
}

TEST(YaraScannerTest, IsUsedAgainAfterEveryVerdict) {
  const auto rules = Compiled(Rule("$a = \"attack\""));
  ASSERT_NE(rules, nullptr);
  YaraScanner scanner(*rules);

  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(scanner.Scan("attack", absl::Seconds(10)), Verdict::kYes);
    EXPECT_EQ(scanner.Scan("nothing", absl::Seconds(10)), Verdict::kNo);
    EXPECT_EQ(scanner.Scan("attack", absl::ZeroDuration()), Verdict::kUnscanned);
    EXPECT_EQ(scanner.failure(), "no time");
  }
}

TEST(YaraScannerTest, ScansLargePayloads) {
  std::string payload(4 << 20, 'x');
  EXPECT_EQ(Scan(Rule("$a = \"attack\""), payload), Verdict::kNo);
  payload += "attack";
  EXPECT_EQ(Scan(Rule("$a = \"attack\""), payload), Verdict::kYes);
}

TEST(YaraScannerTest, ErrorsOfLibyaraAreUnscanned) {
  const auto rules = Compiled(Rule("$a = \"abcd\"", "#a > 2000000"));
  ASSERT_NE(rules, nullptr);
  YaraScanner scanner(*rules);
  std::string flood;
  for (int i = 0; i < 1'100'000; ++i) flood += "abcd";

  EXPECT_EQ(scanner.Scan(flood, absl::Seconds(60)), Verdict::kUnscanned);
  EXPECT_EQ(scanner.failure(), "a string matches too often");
  EXPECT_EQ(scanner.Scan("abcd", absl::Seconds(60)), Verdict::kNo);
}

TEST(YaraScannerTest, TimeOutIsUnscanned) {
  const auto rules =
      Compiled("rule r { condition: for all i in (0..filesize) : (i >= 0) and false }");
  ASSERT_NE(rules, nullptr);
  YaraScanner scanner(*rules);

  EXPECT_EQ(scanner.Scan(std::string(4 << 20, 'x'), absl::Milliseconds(1)), Verdict::kUnscanned);
  EXPECT_EQ(scanner.failure(), "the scan took too long");
}

TEST(YaraScannerTest, ThreadsShareRules) {
  const auto rules = Compiled(Rule("$a = \"attack\" $b = /fo{2,5}bar/"));
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&rules] {
      YaraScanner scanner(*rules);
      for (int round = 0; round < 200; ++round) {
        EXPECT_EQ(scanner.Scan("a fooobar", absl::Seconds(60)), Verdict::kYes);
        EXPECT_EQ(scanner.Scan("a fbar", absl::Seconds(60)), Verdict::kNo);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

}  // namespace
}  // namespace rips::inspect
