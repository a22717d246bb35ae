// RuleSet: rule files as a program that can be run here, inspections included.
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_SET_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_SET_H_

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "policy_server/policy/inspect/inspection_set.h"
#include "policy_server/policy/lang/check/compile.h"
#include "services/base/clock.h"

namespace rips::replay {

struct RuleSetOptions {
  lang::CheckedRules::Dialect dialect = lang::CheckedRules::Dialect::kRips;
  engine::OnInspectionError on_inspection_error = engine::OnInspectionError::kMatch;
};

struct RuleSet {
  std::vector<lang::SourceFile> files;
  std::vector<lang::Diagnostic> diagnostics;
  // Null if the rules were refused; `diagnostics` says why.
  std::shared_ptr<const engine::CompiledPolicy> program;
  // Null if the rules inspect nothing.
  std::shared_ptr<const inspect::InspectionSet> inspections;
  // Of the bundle that they are; empty = rule files.
  std::string bundle_id;

  // Null if the rules inspect nothing; Replayer takes it as it is.
  std::unique_ptr<inspect::Session> NewSession() const {
    return inspections == nullptr ? nullptr : inspections->NewSession();
  }
};

// Compiles the files as one program, in this order. YARA files and plugins are those on the disk;
// plugins are run once to see what they speak. Errors: a rule file that cannot be read
// (lang::kFileBytesMax), or as LoadInspections. `clock` as there.
absl::StatusOr<RuleSet> LoadRuleSet(const std::vector<std::string>& paths,
                                    const RuleSetOptions& options, const Clock* clock);

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_SET_H_
