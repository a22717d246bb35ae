// `ripsctl agent`: list, ban, unban, reset-term.
#ifndef RIPS_SERVICES_RIPSCTL_AGENT_COMMAND_H_
#define RIPS_SERVICES_RIPSCTL_AGENT_COMMAND_H_

#include "services/ripsctl/command.h"

namespace rips::ripsctl {

Commands AgentCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_SERVICES_RIPSCTL_AGENT_COMMAND_H_
