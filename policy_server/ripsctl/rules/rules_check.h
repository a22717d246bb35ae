// `ripsctl rules check`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_CHECK_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_CHECK_H_

#include <memory>

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

// Checks rule files as one policy, or one bundle as the server does when it takes it. Runs nothing.
// Refuses what has errors, or with --werror warnings; kUsage for what cannot be read or is
// neither. Text: diagnostics, problems, and at last `ok: ...` or `refused: ...`. JSON, a contract:
// lang::RenderJson of the rule files, and of a bundle besides
// "bundle":{"name","id","ok","problems":[..],"warnings":[..]}; a refused one has no id.
std::unique_ptr<Command> CheckRules();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_CHECK_H_
