// `ripsctl record`: what a robot's rules are given to judge, into a file for `rules replay`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_ROBOT_RECORD_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_ROBOT_RECORD_COMMAND_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

// One command without a verb.
Commands RecordCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_ROBOT_RECORD_COMMAND_H_
