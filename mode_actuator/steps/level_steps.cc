#include "mode_actuator/steps/level_steps.h"

#include <algorithm>
#include <variant>

#include "mode_actuator/steps/alarm/alarm_step.h"
#include "mode_actuator/steps/firewall/firewall_step.h"
#include "mode_actuator/steps/program/program_step.h"
#include "mode_actuator/steps/system_mode/mode_steps.h"
#include "services/base/overloaded.h"

namespace rips::actuator {
namespace {

// Null if `all` is, or has none of that name.
template <typename Spec>
const Spec* Named(const std::vector<Spec>* all, absl::string_view name) {
  if (all == nullptr) return nullptr;
  const auto found =
      std::find_if(all->begin(), all->end(), [&](const Spec& each) { return each.name == name; });
  return found == all->end() ? nullptr : &*found;
}

}  // namespace

std::vector<Level> MakeLevels(const std::vector<LevelSpec>& specs, const StepPorts& ports) {
  const ModeSteps mode_steps(ports.modes, ports.clock);
  const auto make = [&](const std::vector<Step>& steps, bool on_drift) {
    Level::Steps made;
    for (const Step& step : steps) {
      made.push_back(
          std::visit(Overloaded{
                         [&](const SystemModeStep&) { return mode_steps.Make(step, on_drift); },
                         [&](const ProgramStep& program) {
                           const ProgramSpec* spec = Named(ports.allowed, program.name);
                           return MakeProgramStep(step, spec != nullptr && spec->drill,
                                                  ports.programs, ports.clock);
                         },
                         [&](const AlarmStep& alarm) {
                           const AlarmSpec* spec = Named(ports.devices, alarm.device);
                           return MakeAlarmStep(step, spec != nullptr && spec->flash_in_drills,
                                                ports.alarms, ports.clock);
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

const Level* FindLevel(const std::vector<Level>& levels, absl::string_view name) {
  return Named(&levels, name);
}

}  // namespace rips::actuator
