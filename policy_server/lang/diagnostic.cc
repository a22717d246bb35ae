#include "policy_server/lang/diagnostic.h"

namespace rips::lang {

absl::string_view Name(DiagnosticKind kind) {
  switch (kind) {
#define RIPS_DIAGNOSTIC(name, severity) \
  case DiagnosticKind::k##name:         \
    return #name;
#include "policy_server/lang/diagnostic_kind.def"
  }
  return "";
}

DiagnosticSeverity SeverityOf(DiagnosticKind kind) {
  switch (kind) {
#define RIPS_DIAGNOSTIC(name, severity) \
  case DiagnosticKind::k##name:         \
    return DiagnosticSeverity::k##severity;
#include "policy_server/lang/diagnostic_kind.def"
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

}  // namespace rips::lang
