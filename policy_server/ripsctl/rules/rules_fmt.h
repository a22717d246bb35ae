// `ripsctl rules fmt`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_FMT_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_FMT_H_

#include <memory>

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

// Lays rule files out: prints one, rewrites them (`--write`) or names those that would change
// (`--check`). Exits with kRefused if a file does not parse, or if `--check` names one. JSON:
// {"files":[{"path","ok","diagnostics":[..],"changed":bool,"text"?}]}, `text` when it is printed.
std::unique_ptr<Command> FmtRules();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_FMT_H_
