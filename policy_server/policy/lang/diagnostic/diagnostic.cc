#include "policy_server/policy/lang/diagnostic/diagnostic.h"

#include <algorithm>
#include <tuple>
#include <utility>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/limits.h"

namespace rips::lang {

absl::string_view Name(DiagnosticKind kind) {
  switch (kind) {
#define RIPS_DIAGNOSTIC(name, severity) \
  case DiagnosticKind::k##name:         \
    return #name;
#include "policy_server/policy/lang/diagnostic/diagnostic_kind.def"
  }
  return "";
}

DiagnosticSeverity SeverityOf(DiagnosticKind kind) {
  switch (kind) {
#define RIPS_DIAGNOSTIC(name, severity) \
  case DiagnosticKind::k##name:         \
    return DiagnosticSeverity::k##severity;
#include "policy_server/policy/lang/diagnostic/diagnostic_kind.def"
  }
  return DiagnosticSeverity::kError;
}

absl::string_view Name(DiagnosticSeverity severity) {
  switch (severity) {
    case DiagnosticSeverity::kError:
      return "error";
    case DiagnosticSeverity::kWarning:
      return "warning";
    case DiagnosticSeverity::kNote:
      return "note";
  }
  return "";
}

std::vector<Diagnostic> SortAndCut(std::vector<Diagnostic> diagnostics) {
  std::stable_sort(
      diagnostics.begin(), diagnostics.end(), [](const Diagnostic& a, const Diagnostic& b) {
        return std::tie(a.range.file, a.range.offset) < std::tie(b.range.file, b.range.offset);
      });
  std::vector<Diagnostic> out;
  absl::flat_hash_map<std::pair<uint32_t, DiagnosticSeverity>, size_t> counts;
  for (Diagnostic& diagnostic : diagnostics) {
    const DiagnosticSeverity severity = SeverityOf(diagnostic.kind);
    const auto errors = counts.find({diagnostic.range.file, DiagnosticSeverity::kError});
    if (errors != counts.end() && errors->second > kDiagnosticsMax) continue;
    const size_t count = ++counts[{diagnostic.range.file, severity}];
    if (count <= kDiagnosticsMax) {
      out.push_back(std::move(diagnostic));
    } else if (count == kDiagnosticsMax + 1) {
      const bool is_error = severity == DiagnosticSeverity::kError;
      out.push_back({.kind = DiagnosticKind::kTooManyDiagnostics,
                     .range = diagnostic.range,
                     .message = absl::StrCat("more than ", kDiagnosticsMax,
                                             is_error ? " errors" : " warnings",
                                             " in this file; the rest is not shown")});
    }
  }
  return out;
}

}  // namespace rips::lang
