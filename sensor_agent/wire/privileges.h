// What a process may do, given up.
#ifndef RIPS_SENSOR_AGENT_WIRE_PRIVILEGES_H_
#define RIPS_SENSOR_AGENT_WIRE_PRIVILEGES_H_

#include "absl/status/status.h"

namespace rips::wire {

// Gives up every capability of this thread, and with no_new_privs the way to new ones. Before other
// threads start: those keep theirs. Open sockets stay open. Internal with the system's error.
absl::Status DropPrivileges();

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_PRIVILEGES_H_
