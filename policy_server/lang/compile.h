// Text to checked rules, in one call.
#ifndef RIPS_POLICY_SERVER_LANG_COMPILE_H_
#define RIPS_POLICY_SERVER_LANG_COMPILE_H_

#include <optional>
#include <string>
#include <vector>

#include "policy_server/lang/checked_rules.h"
#include "policy_server/lang/diagnostic.h"
#include "policy_server/lang/inspection_files.h"

namespace rips::lang {

struct SourceFile {
  // As diagnostics name it.
  std::string path;
  std::string text;
};

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

// All diagnostics as text: `path:line:col: error: message`, the line, a caret, the hint.
std::string RenderText(const std::vector<SourceFile>& files,
                       const std::vector<Diagnostic>& diagnostics);

// Where each diagnostic is and of which kind, without anything of the text: for logs, which must
// not hold rules. One `path:line:col: error TypeMismatch` a line.
std::string RenderPlaces(const std::vector<SourceFile>& files,
                         const std::vector<Diagnostic>& diagnostics);

// One line of JSON, valid UTF-8 whatever the files hold:
// {"files":[{"path","ok":bool,"diagnostics":[{"line","column","severity","kind","message",
// "hint"?}]}]}; lines and columns from 1, columns in code points. A contract: fields may be added.
std::string RenderJson(const std::vector<SourceFile>& files,
                       const std::vector<Diagnostic>& diagnostics);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_LANG_COMPILE_H_
