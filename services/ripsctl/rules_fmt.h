// `ripsctl rules fmt`.
#ifndef RIPS_SERVICES_RIPSCTL_RULES_FMT_H_
#define RIPS_SERVICES_RIPSCTL_RULES_FMT_H_

#include <memory>

#include "services/ripsctl/command.h"

namespace rips::ripsctl {

// Lays rule files out: prints one, rewrites them (`--write`) or names those that would change
// (`--check`). Exits with kRefused if a file does not parse, or if `--check` names one. JSON:
// {"files":[{"path","ok","diagnostics":[..],"changed":bool,"text"?}]}, `text` when it is printed.
std::unique_ptr<Command> FmtRules();

}  // namespace rips::ripsctl

#endif  // RIPS_SERVICES_RIPSCTL_RULES_FMT_H_
