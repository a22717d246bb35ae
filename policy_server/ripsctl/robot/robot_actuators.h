// `ripsctl robot receipts` and `ripsctl robot drill`: what a robot's actuators answered, and
// whether they could carry out its levels.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_ACTUATORS_H_
#define RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_ACTUATORS_H_

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

// Of what a program printed, shown to people: the last lines.
inline constexpr size_t kOutputLinesShown = 10;
// A drill is answered within 30 s; whatever --timeout says, it is waited for.
inline constexpr absl::Duration kDrillTimeout = absl::Seconds(35);

// `drill` exits with 0 if every actuator has answered and every step works, else with 1.
Commands ActuatorCommands();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_ROBOT_ROBOT_ACTUATORS_H_
