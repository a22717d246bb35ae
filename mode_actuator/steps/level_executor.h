// Carries out one job of the executor: the leave and enter steps of levels, or a look at the robot.
// A survey is in mode_survey.h.
//
// Entering: the leave steps of the old level one by one, then of the new level first the system
// modes and firewall steps in order, then all programs and alarms at once. On a raise the leave
// steps together get kLeaveBudget and cannot stop what follows, and a firewall release among them
// is not run; on a lowering a failed step stops (level_plan.h).
// A level is reached when every system mode and firewall step of it was read back and no program or
// alarm counts as failed.
//
// The on_drift steps run as enter steps do on a raise; what a failed one stops is the rest of them.
//
// A check looks at all but programs, and firewall steps renew themselves by it. What an alarm with
// `continue` is worth there:
// | the alarm                                            | the level |
// |------------------------------------------------------|-----------|
// | is otherwise, or was plugged in and not told since   | left      |
// | is otherwise, as it was right after it was told      | held      |
// | is not there, or does not answer                     | held      |
// Any other step that is not as wanted, or cannot be looked at, means that the level was left.
#ifndef RIPS_MODE_ACTUATOR_STEPS_LEVEL_EXECUTOR_H_
#define RIPS_MODE_ACTUATOR_STEPS_LEVEL_EXECUTOR_H_

#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/level_controller.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/alarms.h"
#include "mode_actuator/steps/port/part_modes.h"
#include "mode_actuator/steps/port/program_runner.h"
#include "mode_actuator/steps/port/step_attempt.h"
#include "mode_actuator/steps/port/step_runner.h"
#include "services/base/clock.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {

// All leave steps of one raise.
inline constexpr absl::Duration kLeaveBudget = absl::Seconds(2);
// Looking at all alarms of a level, which may be eight relays of one slow board.
inline constexpr absl::Duration kAlarmLookTime = absl::Seconds(3);

// Who carries out the further kinds of steps that are entered in order and checked. Not owned; null
// if no level has such a step.
struct StepRunners {
  StepRunner* firewall = nullptr;
};

// One thread at a time.
class LevelExecutor {
 public:
  // Nothing is owned; all outlive this. `modes` may be null if no level has a system mode, `alarms`
  // if none has an alarm.
  LevelExecutor(const std::vector<LevelSpec>* levels, PartModes* modes, ProgramRunner* programs,
                Alarms* alarms, const Clock* clock, StepRunners runners = {})
      : levels_(levels),
        modes_(modes),
        programs_(programs),
        alarms_(alarms),
        clock_(clock),
        runners_(runners) {}

  // Returns when done or soon after `cancel`.
  LevelOutcome Run(const ApplyLevel& job, const CancelFlag& cancel);

 private:
  enum class Phase { kLeave, kEnter, kOnDrift };

  struct Progress {
    bool raise = true;
    bool failed = false;   // the level is not reached
    bool stopped = false;  // no further steps
    int64_t leave_until_ns = 0;
  };

  const LevelSpec* Find(absl::string_view name) const;
  void Leave(const LevelSpec& level, Progress& progress, const CancelFlag& cancel,
             LevelOutcome& outcome);
  void Enter(const LevelSpec& level, Progress& progress, const CancelFlag& cancel,
             LevelOutcome& outcome);
  void OnDrift(const LevelSpec& level, const CancelFlag& cancel, LevelOutcome& outcome);
  void Survey(const CancelFlag& cancel, LevelOutcome& outcome);
  void Check(const LevelSpec& level, const CancelFlag& cancel, LevelOutcome& outcome);
  // As the step says, or as `overridden_` does.
  SystemModeStep Wanted(const SystemModeStep& step) const;
  // Of a system mode or firewall step.
  StepReading EnterOne(const Step& step, absl::Duration timeout, int retries,
                       const CancelFlag& cancel);
  StepReading CheckOne(const Step& step, const CancelFlag& cancel);
  StepResult EnterRead(const Step& step, absl::Duration timeout, int retries,
                       const CancelFlag& cancel, LevelOutcome& outcome);
  void CheckAlarms(const LevelSpec& level, const CancelFlag& cancel, LevelOutcome& outcome);
  // True if the level holds although the look at alarm `index` of `level` gave `status`.
  bool Tolerates(const LevelSpec& level, size_t index, const absl::Status& status) const;
  // Runs `steps` (indices into `all`, programs and alarms) at the same time; gives their results.
  std::vector<StepResult> RunTogether(Phase phase, const std::vector<Step>& all,
                                      const std::vector<size_t>& steps, absl::Duration at_most,
                                      const CancelFlag& cancel, LevelOutcome& outcome);
  // Until all are over; after `at_most` they are cancelled.
  void Drive(const std::vector<StepAttempt*>& attempts, absl::Duration at_most,
             const CancelFlag& cancel) const;
  void Count(const Step& step, const StepResult& result, Progress& progress,
             LevelOutcome& outcome) const;
  absl::Duration LeaveLeft(const Progress& progress) const;
  int64_t NowNs() const { return clock_->Now().boottime_ns; }

  const std::vector<LevelSpec>* const levels_;  // Not owned; outlives this.
  PartModes* const modes_;                      // Not owned; outlives this.
  ProgramRunner* const programs_;               // Not owned; outlives this.
  Alarms* const alarms_;                        // Not owned; outlives this.
  const Clock* const clock_;                    // Not owned; outlives this.
  const StepRunners runners_;
  ProgramRequest request_;  // of the programs of the present transition: its levels
  // Programs of the present transition that succeeded, by phase and index: a retry skips them.
  std::set<std::pair<Phase, size_t>> done_;
  // Part -> mode: what on_drift steps have ordered since a level was entered.
  std::map<std::string, std::string> overridden_;
  // Alarms, by index into the enter steps, that were not as told right after they were told.
  std::set<size_t> misread_alarms_;
};

// `system_mode /safety=ALERT`, `program usb_alarm`, `alarm relay-A1=on`,
// `firewall /etc/rips/alert.nft`.
std::string StepName(const Step& step);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_LEVEL_EXECUTOR_H_
