// The system mode steps of a robot's levels.
#ifndef RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MODE_STEPS_H_
#define RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MODE_STEPS_H_

#include <map>
#include <memory>
#include <string>

#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/level_step.h"
#include "mode_actuator/steps/port/part_modes.h"
#include "services/base/clock.h"

namespace rips::actuator {

// Makes steps that know of each other: a part whose mode an on_drift step has ordered stays in that
// mode, whatever the level says, until a level is entered anew. One thread at a time, that of the
// steps; this may go before them.
class ModeSteps {
 public:
  // Not owned; both outlive the steps.
  ModeSteps(PartModes* modes, const Clock* clock) : modes_(modes), clock_(clock) {}

  // `spec` must be a system mode step.
  std::unique_ptr<LevelStep> Make(const Step& spec, bool on_drift) const;

 private:
  PartModes* const modes_;    // Not owned; outlives the steps.
  const Clock* const clock_;  // Not owned; outlives the steps.
  // Part -> mode.
  const std::shared_ptr<std::map<std::string, std::string>> overridden_ =
      std::make_shared<std::map<std::string, std::string>>();
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MODE_STEPS_H_
