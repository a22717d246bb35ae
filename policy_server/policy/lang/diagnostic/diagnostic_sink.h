// Where one stage of the compiler puts its diagnostics.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_DIAGNOSTIC_SINK_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_DIAGNOSTIC_SINK_H_

#include <string>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "policy_server/policy/lang/diagnostic/diagnostic.h"
#include "policy_server/policy/lang/limits.h"

namespace rips::lang {

// Keeps one more of each severity and file than is ever shown, so that a hostile file cannot make
// the list grow while the list still knows that there were too many.
class DiagnosticSink {
 public:
  void Add(DiagnosticKind kind, SourceRange range, std::string message, std::string hint = "") {
    const DiagnosticSeverity severity = SeverityOf(kind);
    if (severity == DiagnosticSeverity::kError) has_errors_ = true;
    if (++counts_[{range.file, severity}] > kDiagnosticsMax + 1) return;
    diagnostics_.push_back(
        {.kind = kind, .range = range, .message = std::move(message), .hint = std::move(hint)});
  }

  // Another error of `file` would not be kept; work that only finds errors may stop.
  bool Full(uint32_t file) const {
    const auto found = counts_.find({file, DiagnosticSeverity::kError});
    return found != counts_.end() && found->second > kDiagnosticsMax;
  }

  bool has_errors() const { return has_errors_; }
  // In the order they were added.
  const std::vector<Diagnostic>& diagnostics() const { return diagnostics_; }

 private:
  bool has_errors_ = false;
  std::vector<Diagnostic> diagnostics_;
  absl::flat_hash_map<std::pair<uint32_t, DiagnosticSeverity>, size_t> counts_;
};

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_DIAGNOSTIC_SINK_H_
