// Tries the steps of a level as far as each can be tried without changing what the robot does: no
// level, isolation or drift is changed, and nothing that level_executor.h keeps is touched.
//
// | step                                        | drilled | what is done                         |
// |---------------------------------------------|---------|--------------------------------------|
// | system_mode                                 | looked  | PartModes::Probe; nothing is ordered |
// | program with `drill: true`                  | done    | run once with RIPS_DRILL=1           |
// | any other program                           | looked  | ProgramRunner::Examine               |
// | alarm of a device with `drill: flash`, that | done    | told its state for kFlashTime, then  |
// | is off while no alarm of the level held is  |         | to be off again, whatever happens    |
// | on                                          |         |                                      |
// | any other alarm                             | looked  | asked; `on` and `off` are both fine  |
// | firewall                                    | looked  | StepRunner::Drill; nothing is loaded |
// | what there was no time for, or cannot be    | not     | nothing; the step counts as failed   |
// | tried                                       |         |                                      |
// The enter steps come first, then the leave steps, whose names begin with `leave: `. One by one,
// without retries.
#ifndef RIPS_MODE_ACTUATOR_STEPS_DRILL_H_
#define RIPS_MODE_ACTUATOR_STEPS_DRILL_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/drill_controller.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/decide/receipt.h"
#include "mode_actuator/steps/port/alarms.h"
#include "mode_actuator/steps/port/part_modes.h"
#include "mode_actuator/steps/port/program_runner.h"
#include "mode_actuator/steps/port/step_runner.h"
#include "services/base/clock.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {

// Of a whole drill; steps that have not begun by then are not tried.
inline constexpr absl::Duration kDrillTime = absl::Seconds(15);
// Of one order to an alarm, at most.
inline constexpr absl::Duration kDrillAlarmTime = absl::Seconds(3);
// How long an alarm is on.
inline constexpr absl::Duration kFlashTime = absl::Milliseconds(300);

// One thread at a time, that of LevelExecutor.
class Drill {
 public:
  // Nothing is owned; all outlive this. Null where no level has such a step. The clock's boottime
  // must really pass.
  struct Robot {
    const std::vector<LevelSpec>* levels = nullptr;
    const std::vector<ProgramSpec>* allowed = nullptr;
    const std::vector<AlarmSpec>* devices = nullptr;
    PartModes* modes = nullptr;
    ProgramRunner* programs = nullptr;
    Alarms* alarms = nullptr;
    StepRunner* firewall = nullptr;
    const Clock* clock = nullptr;
  };

  explicit Drill(const Robot& robot) : robot_(robot) {}

  // Returns when done, after kDrillTime and what its last step takes, or soon after `cancel`.
  // `between` is called before each step and while a program runs; may be empty.
  DrillOutcome Run(const DrillJob& job, const CancelFlag& cancel,
                   const std::function<void()>& between);

 private:
  class ResultSlot;

  const LevelSpec* Find(absl::string_view name) const;
  bool HoldsAlarm(absl::string_view level) const;
  StepResult Try(const Step& step, absl::Duration left, const CancelFlag& cancel);
  StepResult TryProgram(const Step& step, absl::Duration left, const CancelFlag& cancel);
  StepResult RunProgram(const Step& step, absl::Duration left, const CancelFlag& cancel);
  // Until the program is over; nothing if the runner does not say so by `end_ns`.
  std::optional<ProgramResult> AwaitProgram(uint64_t run, const std::shared_ptr<ResultSlot>& slot,
                                            int64_t end_ns, const CancelFlag& cancel);
  StepResult TryAlarm(const Step& step, absl::Duration left, const CancelFlag& cancel);
  StepResult Flash(const AlarmStep& alarm, absl::Duration timeout, const CancelFlag& cancel);
  // Tells the alarm to be off; waits for it unless it is cancelled.
  absl::Status SwitchOff(const std::string& device, absl::Duration timeout,
                         const CancelFlag& cancel);
  int64_t NowNs() const { return robot_.clock->Now().boottime_ns; }

  const Robot robot_;
  // Of the present run: an alarm of the level held is on, so none is flashed.
  bool alarmed_ = false;
  std::function<void()> between_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_DRILL_H_
