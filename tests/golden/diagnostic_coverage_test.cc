// Every kind of diagnostic is shown by some golden file.
#include <map>
#include <set>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "gtest/gtest.h"
#include "policy_server/policy/lang/diagnostic/diagnostic.h"
#include "tests/golden/golden_file.h"

namespace rips::golden {
namespace {

constexpr absl::string_view kKinds[] = {
#define RIPS_DIAGNOSTIC(name, severity) #name,
#include "policy_server/policy/lang/diagnostic/diagnostic_kind.def"
};

// Kinds without a golden file, and where they are tested instead.
const std::map<absl::string_view, absl::string_view> kExempt = {
    {"FileTooLarge", "needs a file of 1 MiB: CompileLimitTest.FileBytes"},
    {"ProgramTooLarge", "needs a file of 1 MiB: CompileLimitTest.ProgramNodes"},
    {"TooManyVariables", "needs 1001 variables: CompileLimitTest.Variables"},
    {"TooManyRules", "needs 10001 rules: CompileLimitTest.Rules"},
    {"StringTooLong", "needs 4097 code points: LexerTest.LimitsNamesAndStrings"},
    {"RegexTooLarge", "needs many large patterns: CompileLimitTest.RegexInstructions"},
    {"MissingInspection", "needs files: InspectionTest.WhatIsWrongWithAFileIsAnErrorAtItsFirstUse"},
    {"BrokenInspection", "needs files: InspectionTest.WhatIsWrongWithAFileIsAnErrorAtItsFirstUse"},
    {"SlowInspection", "needs files: InspectionTest.WhatIsWrongWithAFileIsAnErrorAtItsFirstUse"},
    {"TooManyInspections", "needs 257 files: CompileLimitTest.Inspections"},
    {"ExpressionTooDeep", "needs 4097 operators: CompileLimitTest.ExpressionDepth"},
};

TEST(DiagnosticCoverageTest, EveryKindIsInSomeGoldenFile) {
  std::string all;
  for (const GoldenFile& file : LoadGoldenFiles()) all += file.expected;
  for (const absl::string_view kind : kKinds) {
    const bool shown = all.find(absl::StrCat(" ", kind, ": ")) != std::string::npos;
    EXPECT_NE(shown, kExempt.contains(kind))
        << kind << (shown ? " is exempt but shown" : " is shown by no golden file");
  }
}

TEST(DiagnosticCoverageTest, ExemptionsNameKinds) {
  const std::set<absl::string_view> kinds(std::begin(kKinds), std::end(kKinds));
  for (const auto& [kind, reason] : kExempt) EXPECT_TRUE(kinds.contains(kind)) << kind;
}

}  // namespace
}  // namespace rips::golden
