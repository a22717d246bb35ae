#include "mode_actuator/steps/level_steps.h"

#include <variant>

#include "mode_actuator/steps/alarm/alarm_step.h"
#include "mode_actuator/steps/firewall/firewall_step.h"
#include "mode_actuator/steps/program/program_step.h"
#include "mode_actuator/steps/system_mode/mode_steps.h"
#include "services/base/overloaded.h"

namespace rips::actuator {
std::vector<Level> MakeLevels(const std::vector<LevelSpec>& specs, const StepPorts& ports) {
  const ModeSteps mode_steps(ports.modes, ports.clock);
  const auto make = [&](const std::vector<Step>& steps, bool on_drift) {
    Level::Steps made;
    for (const Step& step : steps) {
      made.push_back(std::visit(
          Overloaded{
              [&](const SystemModeStep&) { return mode_steps.Make(step, on_drift); },
              [&](const ProgramStep& program) {
                const ProgramSpec* spec =
                    ports.allowed == nullptr ? nullptr : FindNamed(*ports.allowed, program.name);
                return MakeProgramStep(step, spec != nullptr && spec->drill, ports.programs,
                                       ports.clock);
              },
              [&](const AlarmStep& alarm) {
                const AlarmSpec* spec =
                    ports.devices == nullptr ? nullptr : FindNamed(*ports.devices, alarm.device);
                return MakeAlarmStep(step, spec != nullptr && spec->flash_in_drills, ports.alarms,
                                     ports.clock);
              },
              [&](const FirewallStep&) {
                return MakeFirewallStep(step, ports.firewall, ports.clock);
              },
          },
          step.what));
    }
    return made;
  };
  std::vector<Level> levels;
  for (const LevelSpec& spec : specs) {
    levels.push_back({.name = spec.name,
                      .enter = make(spec.enter, false),
                      .leave = make(spec.leave, false),
                      .on_drift = make(spec.on_drift, true)});
  }
  return levels;
}

}  // namespace rips::actuator
