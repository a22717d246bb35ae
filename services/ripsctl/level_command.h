// `ripsctl level`: show, history, raise, lower.
#ifndef RIPS_SERVICES_RIPSCTL_LEVEL_COMMAND_H_
#define RIPS_SERVICES_RIPSCTL_LEVEL_COMMAND_H_

#include "services/ripsctl/command.h"

namespace rips::ripsctl {

Commands LevelCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_SERVICES_RIPSCTL_LEVEL_COMMAND_H_
