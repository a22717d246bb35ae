// `ripsctl robot`: list, watch, show, graph, interest, coverage.
#ifndef RIPS_SERVICES_RIPSCTL_ROBOT_COMMAND_H_
#define RIPS_SERVICES_RIPSCTL_ROBOT_COMMAND_H_

#include "services/ripsctl/command.h"

namespace rips::ripsctl {

Commands RobotCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_SERVICES_RIPSCTL_ROBOT_COMMAND_H_
