// Every golden rule file says what it says.
#include <cstdlib>
#include <fstream>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/syntax/ast_printer.h"
#include "policy_server/policy/lang/syntax/lexer.h"
#include "policy_server/policy/lang/syntax/parser.h"
#include "re2/re2.h"
#include "services/base/status_matchers.h"
#include "tests/golden/golden_file.h"

namespace rips::golden {
namespace {

std::string Describe(const std::string& text) {
  const lang::CompileResult result = lang::Compile({{.path = "golden.rul", .text = text}});
  const lang::Source source(0, text);
  std::string out;
  for (const lang::Diagnostic& d : result.diagnostics) {
    const lang::Position at = source.PositionOf(d.range.offset);
    absl::StrAppend(&out, "#= ", at.line, ":", at.column, " ", Name(SeverityOf(d.kind)), " ",
                    Name(d.kind), ": ", d.message, "\n");
    if (!d.hint.empty()) absl::StrAppend(&out, "#=   hint: ", d.hint, "\n");
  }
  return absl::StrCat(out, "#= ", result.rules ? "accepted" : "refused", "\n");
}

TEST(GoldenTest, EveryFileIsJudgedAsItSays) {
  const bool update = std::getenv("RIPS_UPDATE_GOLDENS") != nullptr;
  const std::vector<GoldenFile> files = LoadGoldenFiles();
  ASSERT_FALSE(files.empty());
  for (const GoldenFile& file : files) {
    const std::string actual = Describe(file.input);
    if (update) {
      std::ofstream(file.path, std::ios::binary) << file.input << actual;
    } else {
      EXPECT_EQ(file.expected, actual) << file.path << "\n" << actual;
    }
  }
}

TEST(GoldenTest, AcceptedFilesPrintToFilesThatAreJudgedTheSame) {
  int accepted = 0;
  for (const GoldenFile& file : LoadGoldenFiles()) {
    const lang::CompileResult result = lang::Compile({{.path = "a", .text = file.input}});
    if (!result.rules) continue;
    ++accepted;
    const auto parse = [](const std::string& text) {
      const lang::Source source(0, text);
      lang::DiagnosticSink sink;
      return lang::Parse(source, lang::Lex(source, sink), sink);
    };
    const std::string printed = lang::Print(parse(file.input));
    EXPECT_EQ(lang::Print(parse(printed)), printed) << file.path;
    const lang::CompileResult again = lang::Compile({{.path = "a", .text = printed}});
    ASSERT_TRUE(again.rules.has_value()) << printed;
    EXPECT_EQ(again.rules->rules.size(), result.rules->rules.size()) << file.path;
    EXPECT_EQ(again.rules->levels, result.rules->levels) << file.path;
  }
  EXPECT_GE(accepted, 4);
}

// Of each builtin there is a call that the compiler accepts.
TEST(GoldenTest, AcceptedFilesUseEveryBuiltin) {
  std::string accepted;
  for (const GoldenFile& file : LoadGoldenFiles()) {
    if (lang::Compile({{.path = "a", .text = file.input}}).rules) {
      absl::StrAppend(&accepted, file.input);
    }
  }
  for (const lang::Signature& each : lang::Signatures()) {
    EXPECT_TRUE(RE2::PartialMatch(accepted, absl::StrCat("\\b", each.name, "\\(")))
        << each.name << " is in no accepted file";
  }
}

TEST(GoldenTest, TheEngineRunsWhatTheCompilerAccepts) {
  for (const GoldenFile& file : LoadGoldenFiles()) {
    lang::CompileResult result = lang::Compile({{.path = "a", .text = file.input}});
    if (!result.rules) continue;
    EXPECT_THAT(engine::CompiledPolicy::Create(*std::move(result.rules)), IsOk()) << file.path;
  }
}

// White space between tokens means nothing.
TEST(GoldenTest, AcceptedFilesAreAcceptedWithAnyWhiteSpace) {
  for (const GoldenFile& file : LoadGoldenFiles()) {
    if (!lang::Compile({{.path = "a", .text = file.input}}).rules) continue;
    const lang::Source source(0, file.input);
    lang::DiagnosticSink sink;
    for (const char* space : {"\n", "\t", " # note\r\n"}) {
      std::string text;
      for (const lang::Token& token : lang::Lex(source, sink)) {
        absl::StrAppend(&text, space, file.input.substr(token.offset, token.length));
      }
      EXPECT_TRUE(lang::Compile({{.path = "a", .text = text}}).rules.has_value()) << file.path;
    }
  }
}

}  // namespace
}  // namespace rips::golden
