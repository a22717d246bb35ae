// `ripsctl audit`: a policy server's audit log, verified and read from its files.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_AUDIT_AUDIT_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_AUDIT_AUDIT_COMMAND_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

// verify, tail, export.
Commands AuditCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_AUDIT_AUDIT_COMMAND_H_
