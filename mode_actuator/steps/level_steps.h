// The levels of a robot with steps that can be carried out: what actuator.yaml says, each step with
// its room.
#ifndef RIPS_MODE_ACTUATOR_STEPS_LEVEL_STEPS_H_
#define RIPS_MODE_ACTUATOR_STEPS_LEVEL_STEPS_H_

#include <memory>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/alarms.h"
#include "mode_actuator/steps/port/firewall_control.h"
#include "mode_actuator/steps/port/level_step.h"
#include "mode_actuator/steps/port/part_modes.h"
#include "mode_actuator/steps/port/program_runner.h"
#include "services/base/clock.h"

namespace rips::actuator {

// Not owned; all outlive the steps. Null where no level has such a step.
struct StepPorts {
  PartModes* modes = nullptr;
  ProgramRunner* programs = nullptr;
  Alarms* alarms = nullptr;
  FirewallControl* firewall = nullptr;
  const Clock* clock = nullptr;
  // For drills; null = none may be run or flashed.
  const std::vector<ProgramSpec>* allowed = nullptr;
  const std::vector<AlarmSpec>* devices = nullptr;
};

struct Level {
  using Steps = std::vector<std::unique_ptr<LevelStep>>;
  std::string name;
  Steps enter;
  Steps leave;
  Steps on_drift;
};

std::vector<Level> MakeLevels(const std::vector<LevelSpec>& specs, const StepPorts& ports);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_LEVEL_STEPS_H_
