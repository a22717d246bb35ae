// `ripsctl record`: what a robot's rules are given to judge, into a file for `rules replay`.
#ifndef RIPS_SERVICES_RIPSCTL_RECORD_COMMAND_H_
#define RIPS_SERVICES_RIPSCTL_RECORD_COMMAND_H_

#include "services/ripsctl/command.h"

namespace rips::ripsctl {

// One command without a verb.
Commands RecordCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_SERVICES_RIPSCTL_RECORD_COMMAND_H_
