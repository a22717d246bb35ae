// What a process gives up before hostile bytes reach it. Shared by plugins and scanners.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_CONFINE_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_CONFINE_H_

#include <string>

#include "policy_server/policy/inspect/jail_spec.h"

namespace rips::inspect {

// To kReportFd.
void ReportMissing(const std::string& what);
// The same, and ends the process.
[[noreturn]] void FailJail(const std::string& why);
// The same, with what `errno` says after `why`.
[[noreturn]] void FailJailWithErrno(const std::string& why);

// Empties the capability sets for good, and takes the ids without supplementary groups. Fails if
// the ids cannot be taken; without ids the groups of the caller stay, which is told if there are
// any.
void DropRights(const JailSpec& spec, bool may_drop_groups);
// Memory, files and cores. A limit of tasks only if `limit_tasks`: it counts all of the user's
// where there is no user namespace.
void ApplyLimits(const JailSpec& spec, bool limit_tasks);
// This and what it starts gains no rights by executing files.
void ForbidNewRights();

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_CONFINE_H_
