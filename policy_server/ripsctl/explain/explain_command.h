// `ripsctl explain`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_EXPLAIN_EXPLAIN_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_EXPLAIN_EXPLAIN_COMMAND_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

Commands ExplainCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_EXPLAIN_EXPLAIN_COMMAND_H_
