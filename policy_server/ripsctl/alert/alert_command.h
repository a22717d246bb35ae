// `ripsctl alert`: list, watch.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_ALERT_ALERT_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_ALERT_ALERT_COMMAND_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

Commands AlertCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_ALERT_ALERT_COMMAND_H_
