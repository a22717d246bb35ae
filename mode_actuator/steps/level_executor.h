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
// | is otherwise, or was plugged in and not set since    | left      |
// | is otherwise, as it was right after it was set       | held      |
// | is not there, or does not answer                     | held      |
// Any other step that is not as wanted, or cannot be checked, means that the level was left.
#ifndef RIPS_MODE_ACTUATOR_STEPS_LEVEL_EXECUTOR_H_
#define RIPS_MODE_ACTUATOR_STEPS_LEVEL_EXECUTOR_H_

#include <cstdint>
#include <memory>
#include <vector>

#include "absl/time/time.h"
#include "mode_actuator/decide/level_controller.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/level_steps.h"
#include "mode_actuator/steps/port/level_step.h"
#include "services/base/clock.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {

// All leave steps of one raise.
inline constexpr absl::Duration kLeaveBudget = absl::Seconds(2);

// One thread at a time.
class LevelExecutor {
 public:
  // `specs` is not owned and outlives this, as `ports` do.
  LevelExecutor(const std::vector<LevelSpec>* specs, const StepPorts& ports)
      : specs_(specs), ports_(ports), levels_(MakeLevels(*specs, ports)) {}

  // Returns when done or soon after `cancel`.
  LevelOutcome Run(const ApplyLevel& job, const CancelFlag& cancel);

 private:
  struct Progress {
    LevelStep::EnterOptions options;  // of its steps, but for timeout and retries
    bool raise = true;
    bool failed = false;   // the level is not reached
    bool stopped = false;  // no further steps
    int64_t leave_until_ns = 0;
  };

  void Leave(const Level& level, Progress& progress, LevelOutcome& outcome);
  void Enter(const Level& level, Progress& progress, LevelOutcome& outcome);
  void OnDrift(const Level& level, Progress& progress, LevelOutcome& outcome);
  void Survey(const CancelFlag& cancel, LevelOutcome& outcome);
  void Check(const Level& level, const CancelFlag& cancel, LevelOutcome& outcome);
  // A leave step of a raise.
  StepResult LeaveInTime(LevelStep& step, const Progress& progress, LevelOutcome& outcome);
  // Runs `steps` at the same time, each with its own timeout and retries but for what `at_most`
  // leaves; gives their results. `observes`: the outcome reports what they saw.
  std::vector<StepResult> RunSteps(const std::vector<LevelStep*>& steps, const Progress& progress,
                                   absl::Duration at_most, bool observes, LevelOutcome& outcome);
  // RunSteps without a limit of time of its own, and Count of each.
  void RunAndCount(const std::vector<LevelStep*>& steps, bool observes, Progress& progress,
                   LevelOutcome& outcome);
  // Until all are over; after `at_most` they are cancelled.
  void Drive(const std::vector<std::unique_ptr<StepAttempt>>& attempts, absl::Duration at_most,
             const CancelFlag& cancel) const;
  // What a check of steps says, in their order.
  void Judge(const std::vector<LevelStep*>& steps,
             const std::vector<std::unique_ptr<StepAttempt>>& checks, LevelOutcome& outcome) const;
  void Count(const LevelStep& step, const StepResult& result, Progress& progress,
             LevelOutcome& outcome) const;
  int64_t NowNs() const { return ports_.clock->Now().boottime_ns; }

  const std::vector<LevelSpec>* const specs_;  // Not owned; outlives this.
  const StepPorts ports_;
  const std::vector<Level> levels_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_LEVEL_EXECUTOR_H_
