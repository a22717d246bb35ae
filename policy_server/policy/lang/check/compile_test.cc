#include "policy_server/policy/lang/check/compile.h"

#include <algorithm>
#include <limits>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/limits.h"

namespace rips::lang {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr absl::string_view kHead = "levels: DEFAULT; HALT; rules Graph: false ? trigger(HALT);\n";

std::vector<std::string> Lines(const std::vector<SourceFile>& files, const CompileResult& result) {
  std::vector<std::string> out;
  for (const Diagnostic& d : result.diagnostics) {
    const Position at = Source(0, files[d.range.file].text).PositionOf(d.range.offset);
    out.push_back(absl::StrCat(files[d.range.file].path, ":", at.line, ":", at.column, " ",
                               Name(d.kind), ": ", d.message));
  }
  return out;
}

std::vector<std::string> Diagnose(const std::vector<SourceFile>& files) {
  return Lines(files, Compile(files));
}

std::vector<std::string> DiagnoseText(absl::string_view text) {
  return Diagnose({{.path = "t", .text = std::string(text)}});
}

CheckedRules CompileGood(absl::string_view text) {
  const std::vector<SourceFile> files = {{.path = "t", .text = std::string(text)}};
  CompileResult result = Compile(files);
  EXPECT_TRUE(result.rules.has_value()) << RenderText(files, result.diagnostics);
  return result.rules.value_or(CheckedRules{});
}

std::string Repeat(absl::string_view text, size_t count) {
  std::string out;
  for (size_t i = 0; i < count; ++i) absl::StrAppend(&out, text);
  return out;
}

TEST(CompileTest, TypesTheRuleOfThePaper) {
  const CheckedRules rules = CompileGood(
      "levels: DEFAULT; soft ALERT; COMPROMISED; HALT;\n"
      "rules Msg:\n"
      "  R: topicin(\"/videocorridor\") ? {\n"
      "    alert(\"info: rule R activated\");\n"
      "    exec(\"usb_alarm\") !> alert(\"warning: usb_alarm failed\");\n"
      "    trigger(HALT);\n"
      "  }\n"
      "  false ? trigger(ALERT), trigger(COMPROMISED);\n");

  EXPECT_THAT(rules.levels.names(), ElementsAre("DEFAULT", "ALERT", "COMPROMISED", "HALT"));
  EXPECT_TRUE(rules.levels.at(1).soft);
  EXPECT_FALSE(rules.levels.at(2).soft);
  EXPECT_THAT(rules.programs, ElementsAre("usb_alarm"));
  ASSERT_EQ(rules.rules.size(), 2u);
  const TypedRule& rule = rules.rules[0];
  EXPECT_EQ(rule.name, "R");
  EXPECT_EQ(rule.section, EventClass::kMsg);
  EXPECT_EQ(rule.condition.builtin, Builtin::kTopicIn);
  ASSERT_EQ(rule.chains.size(), 3u);
  ASSERT_EQ(rule.chains[1].size(), 2u);
  EXPECT_EQ(rule.chains[1][0].kind, ActionKind::kExec);
  EXPECT_EQ(rule.chains[1][0].next, Connector::kIfFailed);
  EXPECT_EQ(rule.chains[1][1].next, Connector::kEnd);
  EXPECT_EQ(rule.chains[2][0].kind, ActionKind::kTrigger);
  EXPECT_EQ(rule.chains[2][0].args[0].type, ValueType::kLevel);
  EXPECT_EQ(rule.chains[2][0].args[0].constant, Value(int64_t{3}));
  EXPECT_EQ(rules.rules[1].name, "sect_00000:rule_00001");
}

TEST(CompileTest, NumbersSectionsAndRules) {
  const CheckedRules rules = CompileGood(
      "levels: A; rules Msg: true ? alert(\"1\"); N: true ? alert(\"2\"); true ? alert(\"3\");\n"
      "rules Graph: rules MsgGraph: true ? alert(\"4\");");
  ASSERT_EQ(rules.rules.size(), 4u);
  EXPECT_EQ(rules.rules[0].name, "sect_00000:rule_00000");
  EXPECT_EQ(rules.rules[1].name, "N");
  EXPECT_EQ(rules.rules[2].name, "sect_00000:rule_00002");
  EXPECT_EQ(rules.rules[3].name, "sect_00002:rule_00000");
  EXPECT_EQ(rules.rules[3].section, EventClass::kMsg);
}

TEST(CompileTest, FoldsConstants) {
  const CheckedRules rules = CompileGood(
      "levels: A; B soft;\n"
      "consts: n int = 2 * 3 - -1; s string = \"a\" + string(n) + levelname(B); t float = 1./4.;\n"
      "  m int = -9223372036854775808 / -1; L int = B; set1 set string = {s, \"z\"};\n"
      "vars: v int = n % 4; d float = t;\n"
      "rules Graph: nodes(set1, \"y\") && v + n > 0 && d < t ?\n"
      "  set(v, m), set(d, 1.0), exec(s, set1), trigger(L);");
  ASSERT_EQ(rules.variables.size(), 2u);
  EXPECT_EQ(rules.variables[0].initial, Value(int64_t{3}));
  EXPECT_EQ(rules.variables[1].initial, Value(0.25));
  const TypedChain& chain = rules.rules[0].chains[0];
  EXPECT_EQ(chain[0].args[0].constant, Value(std::numeric_limits<int64_t>::min()));
  ASSERT_EQ(chain[2].args.size(), 3u);
  EXPECT_EQ(chain[2].args[0].constant, Value(std::string("a7B")));
  EXPECT_EQ(chain[2].args[2].constant, Value(std::string("z")));
  EXPECT_EQ(chain[3].args[0].type, ValueType::kLevel);
  // ((nodes && v + n > 0) && d < t), and the set's members in place of its name.
  const TypedExpr& condition = rules.rules[0].condition;
  EXPECT_EQ(condition.args[0].args[0].args.size(), 3u);
  EXPECT_EQ(condition.args[0].args[0].args[0].constant, Value(std::string("a7B")));
}

TEST(CompileTest, ShortCircuitsConstantsOnTheLeftOnly) {
  const CheckedRules rules = CompileGood(
      "levels: A; rules Msg: false && topicin(\"/a\") ? alert(\"\");\n"
      "true && topicin(\"/a\") ? alert(\"\"); topicin(\"/a\") && false ? alert(\"\");");
  EXPECT_EQ(rules.rules[0].condition.constant, Value(false));
  EXPECT_EQ(rules.rules[1].condition.kind, TypedExpr::Kind::kCall);
  EXPECT_EQ(rules.rules[2].condition.kind, TypedExpr::Kind::kBinary);
}

TEST(CompileTest, ReadsFilesAsOneProgram) {
  const std::vector<SourceFile> files = {
      {.path = "levels.rul", .text = "levels: A; vars: x int = 0;"},
      {.path = "one.rul", .text = "rules Msg: R: x > 1 ? set(x, 0);"},
      {.path = "two.rul", .text = "rules Msg: R: y ? set(x, 0);"}};
  EXPECT_THAT(Diagnose(files),
              ElementsAre("two.rul:1:12 DuplicateRuleName: two rules are called `R`",
                          "two.rul:1:15 UnknownName: unknown name `y`"));
}

TEST(CompileTest, SaysThatANameIsDeclaredLater) {
  EXPECT_THAT(DiagnoseText("levels: A; consts: a int = b; b int = 1;"),
              Contains("t:1:28 UnknownName: `b` is declared only further on"));
}

TEST(CompileTest, DoesNotJudgeWhatFollowsAnUnreadableFile) {
  const std::vector<SourceFile> files = {{.path = "a", .text = "levels: A; \xFF"},
                                         {.path = "b", .text = "rules Msg: x ? nothing(); ;"}};
  EXPECT_THAT(Diagnose(files),
              ElementsAre("a:1:12 InvalidUtf8: the file is not UTF-8 at byte offset 11",
                          "b:1:27 SyntaxError: expected an expression, found `;`"));
}

TEST(CompileTest, AMistakeInADeclarationIsOneMistake) {
  EXPECT_THAT(DiagnoseText("levels: A B;\nvars: x int = ; y flot = 1;\n"
                           "rules Msg: x > y && x ? set(x, y), set(y, 3), trigger(A);"),
              ElementsAre("t:1:11 SyntaxError: expected `;` after the level, found `B`",
                          "t:2:15 SyntaxError: expected an expression, found `;`",
                          "t:2:19 UnknownType: unknown type `flot`"));
}

TEST(CompileTest, WarnsOnceAboutNothing) {
  EXPECT_THAT(DiagnoseText(""), ElementsAre("t:1:1 EmptyFile: the file declares nothing"));
  EXPECT_THAT(DiagnoseText("# nothing\n"),
              ElementsAre("t:1:1 EmptyFile: the file declares nothing"));
  EXPECT_THAT(DiagnoseText("levels: A; B; vars: x int = 0;"),
              ElementsAre("t:1:1 NoRules: there are no rules"));
  EXPECT_TRUE(Compile({{.path = "t", .text = "levels: A; B;"}}).rules.has_value());
  EXPECT_TRUE(Compile({}).rules.has_value());
}

// What was not in the paper's language may be taken over, what was may not.
TEST(CompileTest, AFileMayKeepItsOwnMeaningOfExtensions) {
  const auto check = [](absl::string_view name, bool extension) {
    const std::vector<SourceFile> files = {
        {.path = "t",
         .text = absl::StrCat("levels: A; vars: ", name, " int = 0; rules Msg: ", name,
                              " > 1 ? set(", name, ", 1);")}};
    const CompileResult result = Compile(files);
    EXPECT_EQ(result.rules.has_value(), extension) << name;
    EXPECT_THAT(Lines(files, result),
                Contains(HasSubstr(extension ? "OwnMeaning" : "HidesLanguageName")));
  };
  for (const Signature& entry : Signatures()) check(entry.name, entry.extension);
  for (const ActionSignature& entry : ActionSignatures()) check(entry.name, false);
  for (const PredefinedName& entry : PredefinedNames()) check(entry.name, entry.extension);
  EXPECT_TRUE(Compile({{.path = "t",
                        .text = "levels: A; consts: Level int = 3; rules Msg: true ? "
                                "alert(string(Level));"}})
                  .rules.has_value());
}

// Answers by the path that it is asked about.
class FakeInspectionFiles : public InspectionFiles {
 public:
  std::vector<InspectionProblem> Check(const Inspection& inspection) override {
    asked.push_back(inspection.path);
    if (inspection.path == "d/ok.yar" || inspection.path == "d/plugins/ok") return {};
    return {{.kind = InspectionProblem::Kind::kMissing, .message = "no such file"},
            {.kind = InspectionProblem::Kind::kBroken, .message = "broken"},
            {.kind = InspectionProblem::Kind::kSlow, .message = "slow"}};
  }
  std::vector<std::string> asked;
};

TEST(InspectionTest, PathsAreSeenFromTheRuleFileAndAskedOnce) {
  FakeInspectionFiles disk;
  const CompileResult result = Compile(
      {{.path = "d/r.rul",
        .text = "levels: A; rules Msg: topicin(\"/a\") && (payload(\"./x/../ok.yar\") || "
                "payload(\"ok.yar\") || plugin(\"ok\") || payload(\"ok.yar\")) ? alert(\"\");"}},
      {.inspection_files = &disk});
  ASSERT_TRUE(result.rules.has_value());
  EXPECT_THAT(disk.asked, ElementsAre("d/ok.yar", "d/plugins/ok"));
  ASSERT_EQ(result.rules->inspections.size(), 2u);
  EXPECT_EQ(result.rules->inspections[0].path, "d/ok.yar");
  EXPECT_EQ(result.rules->inspections[1].name, "ok");
}

TEST(InspectionTest, WhatIsWrongWithAFileIsAnErrorAtItsFirstUse) {
  FakeInspectionFiles disk;
  const std::vector<SourceFile> files = {
      {.path = "r.rul",
       .text = "levels: A; rules Msg: topicin(\"/a\") && payload(\"b.yar\") ? alert(\"\");"}};
  const CompileResult result = Compile(files, {.inspection_files = &disk});
  EXPECT_FALSE(result.rules.has_value());
  EXPECT_THAT(Lines(files, result), ElementsAre(HasSubstr("MissingInspection: no such file"),
                                                HasSubstr("BrokenInspection: broken"),
                                                HasSubstr("SlowInspection: slow")));
}

TEST(CompileTest, NotesTheDialectOnce) {
  const std::vector<SourceFile> files = {
      {.path = "t",
       .text =
           "levels: A; rules Graph: nodesinclude(\"a\") && topicsinclude(\"/b\") ? alert(\"\");"}};
  EXPECT_THAT(Diagnose(files), ElementsAre(HasSubstr("DialectChoice: dialect `rips`")));
  const CompileResult prototype = Compile(files, {.dialect = CheckedRules::Dialect::kPrototype});
  EXPECT_THAT(Lines(files, prototype),
              ElementsAre(HasSubstr("DialectChoice: dialect `prototype`")));
  EXPECT_EQ(prototype.rules->dialect, CheckedRules::Dialect::kPrototype);
}

TEST(CompileTest, NamesAreNotNormalised) {
  // One letter, and a letter with a combining accent, which no name may hold.
  EXPECT_THAT(DiagnoseText("levels: A; consts: \u00E9 int = 1; E int = 2; rules Msg: true ? "
                           "alert(string(\u00E9 + E));"),
              IsEmpty());
  EXPECT_THAT(DiagnoseText("levels: A; consts: e\u0301 int = 1; rules Msg: true ? alert(\"\");"),
              Contains(HasSubstr("UnexpectedCharacter")));
}

TEST(CompileTest, ADirectiveForTheShellIsAComment) {
  EXPECT_THAT(DiagnoseText("#!/usr/bin/env ripsctl\nlevels: A; rules Msg: true ? alert(\"\");"),
              IsEmpty());
}

// --- trigger(variable) and what it reaches.

TEST(CompileTest, TriggerTakesVariablesThatOnlyHoldLevels) {
  constexpr absl::string_view kGood =
      "levels: A; B; C; vars: v int = A; w int = B; rules Msg: v < w ? "
      "set(v, w), set(w, C), set(w, CurrLevel), trigger(v);";
  EXPECT_THAT(DiagnoseText(kGood), IsEmpty());
  for (const absl::string_view value : {"1", "B + 0", "Time", "u", "-A"}) {
    const std::string text = absl::StrCat(
        "levels: A; B; C; vars: v int = A; w int = B; u int = 0; rules Msg: v < w ? "
        "set(v, w), set(w, ",
        value, "), set(u, C), trigger(v);");
    EXPECT_THAT(DiagnoseText(text),
                Contains(HasSubstr("BadTriggerLevel: `v` may hold an integer that is not a level")))
        << value;
  }
}

TEST(CompileTest, TriggerRefusesEverythingElse) {
  for (const absl::string_view arg :
       {"1", "\"A\"", "A + 0", "CurrLevel + 1", "Time", "f", "true"}) {
    EXPECT_THAT(
        DiagnoseText(absl::StrCat(
            "levels: A; vars: f float = 0.; rules Msg: f > 1. ? set(f, 1.), trigger(", arg, ");")),
        ElementsAre(HasSubstr("BadTriggerLevel")))
        << arg;
  }
}

TEST(CompileTest, ReportsUnreachableLevelsOnlyWhenAllElseIsClean) {
  EXPECT_THAT(DiagnoseText("levels: A; B; C; rules Msg: true ? trigger(B);"),
              ElementsAre("t:1:15 LevelUnreachable: no `trigger` reaches level `C`"));
  EXPECT_THAT(DiagnoseText("levels: A; B; C; rules Msg: nothing ? trigger(B);"),
              ElementsAre(HasSubstr("UnknownName")));
  EXPECT_THAT(DiagnoseText("levels: A; B; vars: v int = B; rules Msg: true ? trigger(v), "
                           "set(v, v);"),
              IsEmpty());
}

TEST(CompileTest, CrashReachesNoLevel) {
  EXPECT_THAT(DiagnoseText("levels: A; B; rules Msg: false ? crash(\"x\");"),
              ElementsAre("t:1:12 LevelUnreachable: no `trigger` reaches level `B`"));
}

TEST(CompileTest, SettingAVariableFromItselfIsNoReading) {
  EXPECT_THAT(DiagnoseText("levels: A; vars: x int = 0; rules Msg: true ? set(x, x + 1);"),
              ElementsAre("t:1:18 VariableNeverRead: variable `x` is never read"));
  EXPECT_THAT(DiagnoseText("levels: A; vars: x int = 0; rules Msg: false ? set(x, x);"), IsEmpty());
  EXPECT_THAT(DiagnoseText("levels: A; vars: x int = 0; rules Msg: x > 0 ? alert(\"\");"),
              ElementsAre("t:1:18 VariableNeverSet: variable `x` is never set"));
}

// --- Limits: at the limit all is well, one beyond is an error that names it.

TEST(CompileLimitTest, FileBytes) {
  std::string text(kHead);
  text += "#" + std::string(kFileBytesMax - text.size() - 1, 'x');
  EXPECT_THAT(DiagnoseText(text), IsEmpty());
  EXPECT_THAT(DiagnoseText(text + "x"),
              ElementsAre("t:1:1 FileTooLarge: a file of 1048577 bytes exceeds limit 1048576"));
}

TEST(CompileLimitTest, Levels) {
  const auto levels = [](size_t count) {
    std::string text = "levels: ";
    std::string triggers;
    for (size_t i = 0; i < count; ++i) {
      absl::StrAppend(&text, "L", i, "; ");
      if (i > 0) absl::StrAppend(&triggers, i == 1 ? "" : ", ", "trigger(L", i, ")");
    }
    return absl::StrCat(text, "rules Msg: true ? ", triggers, ";");
  };
  EXPECT_THAT(DiagnoseText(levels(kLevelsMax)), IsEmpty());
  EXPECT_THAT(DiagnoseText(levels(kLevelsMax + 3)),
              ElementsAre(HasSubstr("TooManyLevels: too many levels; a policy has at most 64")));
}

TEST(CompileLimitTest, Variables) {
  const auto variables = [](size_t count) {
    std::string text = "levels: A; vars: ";
    std::string sets;
    for (size_t i = 0; i < count; ++i) {
      absl::StrAppend(&text, "v", i, " int = 0; ");
      absl::StrAppend(&sets, i == 0 ? "" : ", ", "set(v", i, ", v", i, ")");
    }
    return absl::StrCat(text, "rules Msg: true ? ", sets, ";");
  };
  EXPECT_THAT(DiagnoseText(variables(kVariablesMax)), IsEmpty());
  EXPECT_THAT(
      DiagnoseText(variables(kVariablesMax + 3)),
      ElementsAre(HasSubstr("TooManyVariables: too many variables; a policy has at most 1000")));
}

TEST(CompileLimitTest, Rules) {
  const std::string rule = "true ? alert(\"\");";
  const std::string head = "levels: A; rules Msg: ";
  EXPECT_THAT(DiagnoseText(head + Repeat(rule, kRulesMax)), IsEmpty());
  EXPECT_THAT(DiagnoseText(head + Repeat(rule, kRulesMax + 3)),
              ElementsAre(HasSubstr("TooManyRules: too many rules; a policy has at most 10000")));
}

TEST(CompileLimitTest, ProgramNodes) {
  const std::string head = "levels: A; rules Msg: 1 ";
  EXPECT_THAT(DiagnoseText(head + Repeat("+1", kProgramNodesMax) + " == 3 ? alert(\"\");"),
              ElementsAre(HasSubstr("ProgramTooLarge: more than 500000 operators and operands")));

  const std::string half = "1" + Repeat("+1", kProgramNodesMax / 2) + " == Time ? alert(\"\");";
  EXPECT_THAT(Diagnose({{.path = "a", .text = "levels: A; rules Msg: " + half}}), IsEmpty());
  EXPECT_THAT(Diagnose({{.path = "a", .text = "levels: A; rules Msg: " + half},
                        {.path = "b", .text = "rules Msg: " + half}}),
              ElementsAre(HasSubstr("b:1:1 ProgramTooLarge")));
}

TEST(CompileLimitTest, ExpressionDepth) {
  const std::string head = "levels: A; rules Msg: ";
  // Operators that may be grouped at will cost no depth.
  for (const absl::string_view op : {"+", "*", "|", "^", "&"}) {
    EXPECT_THAT(DiagnoseText(head + "(Time" + Repeat(absl::StrCat(op, "Time"), 100000) +
                             ") == 0 ? alert(\"\");"),
                IsEmpty())
        << op;
  }
  EXPECT_THAT(DiagnoseText(head + "Time == 0" + Repeat("||Time==0", 30000) + " ? alert(\"\");"),
              IsEmpty());
  const std::string tail = " == 0 ? alert(\"\");";
  const auto minus = [](size_t count) { return "Time" + Repeat("-Time", count); };
  EXPECT_THAT(DiagnoseText(head + minus(kExpressionDepthMax - 2) + tail), IsEmpty());
  EXPECT_THAT(
      DiagnoseText(head + minus(kExpressionDepthMax) + tail),
      ElementsAre(HasSubstr("ExpressionTooDeep: expression depth 4097 exceeds limit 4096")));
  // Nested runs add up.
  const std::string nested =
      Repeat("(", 3) + minus(1500) + Repeat(")" + Repeat("-Time", 1500), 3) + tail;
  EXPECT_THAT(DiagnoseText(head + nested), ElementsAre(HasSubstr("ExpressionTooDeep")));
}

TEST(CompileLimitTest, DeepestNestingOfEveryPrecedence) {
  const std::string good = "levels: A; rules Msg: 0 == Time + (" +
                           Repeat("1|1^1&1+1*(", kNestingMax - 1) + "Time" +
                           Repeat(")", kNestingMax) + " ? alert(\"\");";
  EXPECT_TRUE(Compile({{.path = "t", .text = good}}).rules.has_value());
}

TEST(CompileLimitTest, RegexInstructions) {
  const auto text = [](size_t count) {
    return "levels: A; rules Msg: " +
           Repeat("topicmatches(\"(\\\\pL{9}){4}\") ? alert(\"\");\n", count);
  };
  EXPECT_THAT(DiagnoseText(text(10)), IsEmpty());
  EXPECT_THAT(DiagnoseText(text(5000)), ElementsAre(HasSubstr("RegexTooLarge")));
}

TEST(CompileLimitTest, Inspections) {
  std::string text = "levels: A; rules Msg:";
  for (size_t i = 0; i < kInspectionsMax; ++i) {
    absl::StrAppend(&text, " topicin(\"/a\") && plugin(\"p", i, "\") ? alert(\"\");");
  }
  EXPECT_THAT(DiagnoseText(text), IsEmpty());
  EXPECT_THAT(DiagnoseText(text + " topicin(\"/a\") && payload(\"x\") ? alert(\"\");"),
              ElementsAre(HasSubstr("TooManyInspections: too many YARA files and plugins; a policy "
                                    "has at most 256")));
}

TEST(CompileLimitTest, FoldedStrings) {
  const std::string half(kStringCodePointsMax / 2, 'x');
  const std::string head =
      absl::StrCat("levels: A; consts: h string = \"", half, "\"; rules Msg: true ? alert(h + h");
  EXPECT_THAT(DiagnoseText(head + ");"), IsEmpty());
  EXPECT_THAT(DiagnoseText(head + " + \"x\");"),
              ElementsAre(HasSubstr("StringTooLong: a constant string of 4097 code points")));
}

TEST(CompileLimitTest, Diagnostics) {
  const std::string head = "levels: A; rules Msg:\n";
  const std::vector<std::string> fifty =
      DiagnoseText(head + Repeat("nothing ? alert(\"\");\n", kDiagnosticsMax));
  EXPECT_EQ(fifty.size(), kDiagnosticsMax);
  const std::vector<std::string> many =
      DiagnoseText(head + Repeat("@\nnothing ? alert(017);\n", 5000));
  ASSERT_EQ(std::count_if(many.begin(), many.end(),
                          [](const std::string& line) {
                            return line.find("LeadingZero") == std::string::npos;
                          }),
            kDiagnosticsMax + 1);
  EXPECT_THAT(many.back(), HasSubstr("TooManyDiagnostics: more than 50 errors in this file"));
  EXPECT_THAT(DiagnoseText(absl::StrCat(kHead, "rules Msg: Time == 1", Repeat(" + 01", 60),
                                        " ? alert(\"\");"))
                  .back(),
              HasSubstr("TooManyDiagnostics: more than 50 warnings in this file"));
}

}  // namespace
}  // namespace rips::lang
