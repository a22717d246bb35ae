// What is wrong with a rule file, for its author.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_DIAGNOSTIC_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_DIAGNOSTIC_H_

#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::lang {

// One per mistake; names and default severities stand in diagnostic_kind.def.
enum class DiagnosticKind {
#define RIPS_DIAGNOSTIC(name, severity) k##name,
#include "policy_server/policy/lang/diagnostic/diagnostic_kind.def"
};

enum class DiagnosticSeverity { kError, kWarning, kNote };

// "UnknownName"; the `kind` of JSON output.
absl::string_view Name(DiagnosticKind kind);
DiagnosticSeverity SeverityOf(DiagnosticKind kind);
// "error", "warning", "note".
absl::string_view Name(DiagnosticSeverity severity);

struct Diagnostic {
  DiagnosticKind kind;
  SourceRange range;
  // Lower case, code in backticks, no final period.
  std::string message;
  // What to do about it; may be empty.
  std::string hint;
};

// By place. Of each file, at most kDiagnosticsMax errors, then a note; the same of what is no
// error.
std::vector<Diagnostic> SortAndCut(std::vector<Diagnostic> diagnostics);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_DIAGNOSTIC_H_
