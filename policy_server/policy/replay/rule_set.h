// RuleSet: rule files or a bundle as a program that can be run here, inspections included.
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_SET_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_SET_H_

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "policy_server/policy/inspect/inspection_set.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/policy/levels/level_table.h"
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
  // Of the bundle that they are; empty = rule files, of which the next three stay as they are.
  std::string bundle_id;
  levels::LevelIndex start_level = 0;
  // How long the evidence must have been complete before a rule may lower a soft level.
  int64_t soft_hold_ns = 0;
  // Levels from which an operator lowers only if a second one approves.
  std::vector<std::string> two_person;

  // Null if the rules inspect nothing; Replayer takes it as it is.
  std::unique_ptr<inspect::Session> NewSession() const {
    return inspections == nullptr ? nullptr : inspections->NewSession();
  }
};

// A single path that is a directory is a bundle: its manifest decides and `options` do not count.
// Errors as bundle::LoadBundle; one that is refused is InvalidArgument.
// Other paths are compiled as one program, in this order. YARA files and plugins are those on the
// disk; plugins are run once to see what they speak. Errors: a rule file that cannot be read
// (lang::kFileBytesMax), or as LoadInspections. `clock` as there.
absl::StatusOr<RuleSet> LoadRuleSet(const std::vector<std::string>& paths,
                                    const RuleSetOptions& options, const Clock* clock);

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_SET_H_
