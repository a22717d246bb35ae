// `ripsctl alert`: list, watch.
#ifndef RIPS_SERVICES_RIPSCTL_ALERT_COMMAND_H_
#define RIPS_SERVICES_RIPSCTL_ALERT_COMMAND_H_

#include "services/ripsctl/command.h"

namespace rips::ripsctl {

Commands AlertCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_SERVICES_RIPSCTL_ALERT_COMMAND_H_
