// `ripsctl rules`: check, fmt, builtins, test, replay, resume.
#ifndef RIPS_SERVICES_RIPSCTL_RULES_COMMAND_H_
#define RIPS_SERVICES_RIPSCTL_RULES_COMMAND_H_

#include "services/ripsctl/command.h"

namespace rips::ripsctl {

Commands RulesCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_SERVICES_RIPSCTL_RULES_COMMAND_H_
