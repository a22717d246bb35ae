// Compiled rules: immutable, shared by all robots and threads that run the same policy.
#ifndef RIPS_POLICY_SERVER_ENGINE_PROGRAM_H_
#define RIPS_POLICY_SERVER_ENGINE_PROGRAM_H_

#include <memory>

#include "absl/status/statusor.h"
#include "policy_server/lang/checked_rules.h"

namespace rips::engine {

class Program {
 public:
  // InvalidArgument if a regular expression does not compile (the checker has refused it already).
  static absl::StatusOr<std::shared_ptr<const Program>> Create(lang::CheckedRules rules);
  ~Program();

  const lang::CheckedRules& rules() const { return rules_; }

  // For the evaluator only.
  struct Compiled;
  const Compiled& compiled() const { return *compiled_; }

 private:
  explicit Program(lang::CheckedRules rules);

  lang::CheckedRules rules_;
  std::unique_ptr<const Compiled> compiled_;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_ENGINE_PROGRAM_H_
