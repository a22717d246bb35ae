// `ripsctl agent`: list, ban, unban, reset-term.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_ROBOT_AGENT_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_ROBOT_AGENT_COMMAND_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

Commands AgentCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_ROBOT_AGENT_COMMAND_H_
