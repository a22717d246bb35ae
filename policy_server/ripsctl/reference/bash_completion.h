// The completion of ripsctl for bash.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_REFERENCE_BASH_COMPLETION_H_
#define RIPS_POLICY_SERVER_RIPSCTL_REFERENCE_BASH_COMPLETION_H_

#include <string>

#include "policy_server/ripsctl/reference/command_tree.h"

namespace rips::ripsctl {

// A script to be sourced: bash 4, nothing else. It completes commands, flags, the values of flags
// that are listed, and contexts, which it reads from the settings file with `ripsctl context list`;
// it asks no server. For other values bash completes names of files.
std::string BashCompletion(const CommandDoc& program);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_REFERENCE_BASH_COMPLETION_H_
