// An alarm step of a level.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_STEP_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_STEP_H_

#include <memory>

#include "absl/time/time.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/alarms.h"
#include "mode_actuator/steps/port/level_step.h"
#include "services/base/clock.h"

namespace rips::actuator {

// Looking at all alarms of a level, which may be eight relays of one slow board.
inline constexpr absl::Duration kAlarmLookTime = absl::Seconds(3);
// In a drill: of one order to an alarm, at most; and how long an alarm is on.
inline constexpr absl::Duration kDrillAlarmTime = absl::Seconds(3);
inline constexpr absl::Duration kFlashTime = absl::Milliseconds(300);

// `spec` must be an alarm step; `flash_in_drills` as its device says. The others are not owned and
// outlive the step. The clock's boottime must really pass.
std::unique_ptr<LevelStep> MakeAlarmStep(const Step& spec, bool flash_in_drills, Alarms* alarms,
                                         const Clock* clock);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_STEP_H_
