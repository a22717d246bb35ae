// `ripsctl robot`: list, watch, show, graph, interest, coverage.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_COMMAND_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

Commands RobotCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_COMMAND_H_
