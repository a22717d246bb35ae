// `ripsctl rules`: check, fmt, builtins, test, replay, resume.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_COMMAND_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

Commands RulesCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_COMMAND_H_
