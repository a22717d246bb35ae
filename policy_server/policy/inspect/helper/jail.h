// Runs a plugin so that nothing of it outlives it, wherever it goes.
//
//   namespaces that can be had           as root           otherwise
//   user and PID                         1                 1
//   PID only (user namespaces forbidden) 2                 3
//   none                                 3                 3
//
//   1  rips-inspect starts an init in new namespaces, which starts the program. The end of any of
//      the three ends all: a session, a group or a second fork leads nowhere. Limits count the
//      program's tasks only.
//   2  the same; the limit of tasks counts all plugins of the user together.
//   3  rips-inspect adopts what loses its parent, and on SIGTERM, or when the program ends, kills
//      its children until there are none. No limit of tasks. The program can signal itself only.
//      Reported.
//
// The cgroup of the run, if there is one, ends all of this too.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_JAIL_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_JAIL_H_

#include "policy_server/policy/inspect/jail_spec.h"

namespace rips::inspect {

// Ends as the program did: with its status, or by SIGKILL if it ended by a signal. Single-threaded
// callers only.
[[noreturn]] void RunJailed(const JailSpec& spec);

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_JAIL_H_
