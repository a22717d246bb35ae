// A firewall step of a level: rips-fw carries it out.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FIREWALL_STEP_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FIREWALL_STEP_H_

#include <memory>

#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/firewall_control.h"
#include "mode_actuator/steps/port/level_step.h"
#include "services/base/clock.h"

namespace rips::actuator {

// `spec` must be a firewall step. The others are not owned and outlive the step.
std::unique_ptr<LevelStep> MakeFirewallStep(const Step& spec, FirewallControl* firewall,
                                            const Clock* clock);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FIREWALL_STEP_H_
