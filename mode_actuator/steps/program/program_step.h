// A program step of a level: its attempts, and its drill.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PROGRAM_PROGRAM_STEP_H_
#define RIPS_MODE_ACTUATOR_STEPS_PROGRAM_PROGRAM_STEP_H_

#include <memory>

#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/level_step.h"
#include "mode_actuator/steps/port/program_runner.h"
#include "services/base/clock.h"

namespace rips::actuator {

// `spec` must be a program step; `drill` says that it may be run as a drill. The others are not
// owned and outlive the step.
std::unique_ptr<LevelStep> MakeProgramStep(const Step& spec, bool drill, ProgramRunner* programs,
                                           const Clock* clock);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PROGRAM_PROGRAM_STEP_H_
