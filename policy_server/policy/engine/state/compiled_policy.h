// Compiled rules: immutable, shared by all robots and threads that run the same policy.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_COMPILED_POLICY_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_COMPILED_POLICY_H_

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::engine {

// What becomes of a rule whose value depends on an inspection that was not told.
enum class OnInspectionError {
  kMatch,   // it fires: whoever can break the inspection gains nothing
  kAlert,   // it does not fire, and that is an alert
  kIgnore,  // it does not fire
};

struct CompiledPolicyOptions {
  OnInspectionError on_inspection_error = OnInspectionError::kMatch;
  // Of the bundle that holds the rules, for traces; empty if they are of none.
  std::string bundle_id = {};
};

class CompiledPolicy {
 public:
  // compile/compiler.cc. InvalidArgument for rules that the checker would have refused.
  static absl::StatusOr<std::shared_ptr<const CompiledPolicy>> Create(
      lang::CheckedRules rules, CompiledPolicyOptions options = {});
  ~CompiledPolicy();

  const lang::CheckedRules& rules() const { return rules_; }
  const CompiledPolicyOptions& options() const { return options_; }

  // For the evaluator only.
  struct Compiled;
  const Compiled& compiled() const { return *compiled_; }

 private:
  CompiledPolicy(lang::CheckedRules rules, CompiledPolicyOptions options);

  lang::CheckedRules rules_;
  CompiledPolicyOptions options_;
  std::unique_ptr<const Compiled> compiled_;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_COMPILED_POLICY_H_
