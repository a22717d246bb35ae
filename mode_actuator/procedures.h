// Carries out one job of the executor: the leave and enter steps of levels, or a look at the robot.
//
// Entering: the leave steps of the old level one by one, then of the new level first the system
// modes in order, then all programs at once. On a raise the leave steps together get
// kLeaveBudget and cannot stop what follows; on a lowering a failed step stops (level_plan.h).
// A level is reached when every system mode of it was read back and no program counts as failed.
#ifndef RIPS_MODE_ACTUATOR_PROCEDURES_H_
#define RIPS_MODE_ACTUATOR_PROCEDURES_H_

#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/cancel_flag.h"
#include "mode_actuator/executor.h"
#include "mode_actuator/level_plan.h"
#include "mode_actuator/part_modes.h"
#include "mode_actuator/program_runner.h"
#include "services/base/clock.h"

namespace rips::actuator {

// All leave steps of one raise.
inline constexpr absl::Duration kLeaveBudget = absl::Seconds(2);

// One thread at a time.
class Procedures {
 public:
  // Nothing is owned; all outlive this. `modes` may be null if no level has a system mode.
  Procedures(const std::vector<LevelSpec>* levels, PartModes* modes, ProgramRunner* programs,
             const Clock* clock)
      : levels_(levels), modes_(modes), programs_(programs), clock_(clock) {}

  // Returns when done or soon after `cancel`.
  LevelOutcome Run(const ApplyLevel& job, const CancelFlag& cancel);

 private:
  enum class Phase { kLeave, kEnter };

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
  void Check(const LevelSpec& level, const CancelFlag& cancel, LevelOutcome& outcome);
  StepResult EnterMode(const SystemModeStep& mode, const Step& step, absl::Duration timeout,
                       int retries, const CancelFlag& cancel, LevelOutcome& outcome);
  // Runs `steps` (indices into `all`, programs only) at the same time.
  std::vector<StepResult> RunPrograms(const std::vector<Step>& all,
                                      const std::vector<size_t>& steps, absl::Duration at_most,
                                      const CancelFlag& cancel);
  void Count(const Step& step, const StepResult& result, Progress& progress,
             LevelOutcome& outcome) const;
  absl::Duration LeaveLeft(const Progress& progress) const;
  int64_t NowNs() const { return clock_->Now().boottime_ns; }

  const std::vector<LevelSpec>* const levels_;  // Not owned; outlives this.
  PartModes* const modes_;                      // Not owned; outlives this.
  ProgramRunner* const programs_;               // Not owned; outlives this.
  const Clock* const clock_;                    // Not owned; outlives this.
  // Programs of the present transition that succeeded, by phase and index: a retry skips them.
  std::set<std::pair<Phase, size_t>> done_;
};

// `system_mode /safety=ALERT`, `program usb_alarm`.
std::string StepName(const Step& step);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_PROCEDURES_H_
