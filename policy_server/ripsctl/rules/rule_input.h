// Rule files as the command line names them.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_RULE_INPUT_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_RULE_INPUT_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/ripsctl/cli/env.h"

namespace rips::ripsctl {

// As a path, means standard input.
inline constexpr absl::string_view kStandardInput = "-";

// Reads them in this order; standard input is called `<stdin>`. InvalidArgument: standard input
// twice; ResourceExhausted: more than lang::kFileBytesMax bytes; else as ReadFile.
absl::StatusOr<std::vector<lang::SourceFile>> ReadRuleFiles(Env& env,
                                                            const std::vector<std::string>& paths);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_RULE_INPUT_H_
