// `ripsctl level`: show, history, raise, lower.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_LEVEL_LEVEL_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_LEVEL_LEVEL_COMMAND_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

Commands LevelCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_LEVEL_LEVEL_COMMAND_H_
