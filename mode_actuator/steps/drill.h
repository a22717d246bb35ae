// Tries the steps of a level as far as each can be tried without changing what the robot does: no
// level, isolation or drift is changed, and nothing that level_executor.h keeps is touched.
//
// | step                                        | drilled | what is done                         |
// |---------------------------------------------|---------|--------------------------------------|
// | system_mode                                 | looked  | PartModes::Probe; nothing is ordered |
// | program with `drill: true`                  | done    | run once with RIPS_DRILL=1           |
// | any other program                           | looked  | ProgramRunner::Examine               |
// | alarm of a device with `drill: flash`, that | done    | set to its state for kFlashTime, then |
// | is off while no alarm of the level held is  |         | to be off again, whatever happens    |
// | on                                          |         |                                      |
// | any other alarm                             | looked  | asked; `on` and `off` are both fine  |
// | firewall                                    | looked  | FirewallControl::Drill; a dry run    |
// | what there was no time for, or cannot be    | not     | nothing; the step counts as failed   |
// | tried                                       |         |                                      |
// The enter steps come first, then the leave steps, whose names begin with `leave: `. One by one,
// without retries.
#ifndef RIPS_MODE_ACTUATOR_STEPS_DRILL_H_
#define RIPS_MODE_ACTUATOR_STEPS_DRILL_H_

#include <cstdint>
#include <functional>
#include <vector>

#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/drill_controller.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/level_steps.h"
#include "services/base/clock.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {

// Of a whole drill; steps that have not begun by then are not tried.
inline constexpr absl::Duration kDrillTime = absl::Seconds(15);

// One thread at a time, that of LevelExecutor.
class Drill {
 public:
  // As for LevelExecutor, with steps of its own: what those keep is not touched.
  Drill(const std::vector<LevelSpec>& specs, const StepPorts& ports)
      : levels_(MakeLevels(specs, ports)), clock_(ports.clock) {}

  // Returns when done, after kDrillTime and what its last step takes, or soon after `cancel`.
  // `between` is called before each step and while a program runs; may be empty.
  DrillOutcome Run(const DrillJob& job, const CancelFlag& cancel,
                   const std::function<void()>& between);

 private:
  // Also if the level is not known: one might be on.
  bool HoldsAlarm(absl::string_view level) const;
  int64_t NowNs() const { return clock_->Now().boottime_ns; }

  const std::vector<Level> levels_;
  const Clock* const clock_;  // Not owned; outlives this.
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_DRILL_H_
