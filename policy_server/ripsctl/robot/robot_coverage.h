// `ripsctl robot interest` and `ripsctl robot coverage`: what is asked of a robot's sensors, what
// is seen of it and what is not.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_COVERAGE_H_
#define RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_COVERAGE_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

// `coverage` exits with 0 if the graph is whole and every endpoint of it watched, not needed or, as
// services, never read by anybody, and no finding stands; else with 1.
Commands CoverageCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_COVERAGE_H_
