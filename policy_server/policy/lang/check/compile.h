// Text to checked rules, in one call.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_CHECK_COMPILE_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_CHECK_COMPILE_H_

#include <optional>
#include <string>
#include <vector>

#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/policy/lang/diagnostic/diagnostic.h"
#include "policy_server/policy/lang/diagnostic/render.h"
#include "policy_server/policy/lang/inspection_files.h"

namespace rips::lang {

struct CompileResult {
  // Absent if there is any error.
  std::optional<CheckedRules> rules;
  // Sorted by file, then position; at most 50 errors a file, then a note.
  std::vector<Diagnostic> diagnostics;
};

struct CompileOptions {
  CheckedRules::Dialect dialect = CheckedRules::Dialect::kRips;
  // Not owned. Null: YARA files and plugins that rules name are not looked at.
  InspectionFiles* inspection_files = nullptr;
};

// Compiles the files as one program, in this order: names declared in one file hold in the next.
CompileResult Compile(const std::vector<SourceFile>& files, const CompileOptions& options = {});

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_CHECK_COMPILE_H_
