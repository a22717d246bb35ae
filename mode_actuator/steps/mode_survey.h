// Reads back which level a robot is at when nothing recorded says so. Nothing is ordered.
//
// Each part is read until the reading is complete or the time is over. What a part shows:
// | its nodes, or its mode manager, are in a mode that | it shows                                |
// | enter steps set                                    | the lowest level that sets just that    |
// |                                                    | mode for this part                      |
// | only on_drift steps set                            | the lowest level with such a step       |
// | nothing of the above sets                          | no level                                |
// Nodes that do not answer say nothing: the others agree with more modes then, and the lowest level
// of these counts. If nodes and mode manager differ, the higher level counts. The robot shows the
// highest level that any of its parts shows. So it is at that level or above it, as far as modes
// can tell.
#ifndef RIPS_MODE_ACTUATOR_STEPS_MODE_SURVEY_H_
#define RIPS_MODE_ACTUATOR_STEPS_MODE_SURVEY_H_

#include <string>
#include <vector>

#include "absl/time/time.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/part_modes.h"
#include "services/base/clock.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {

// One whole survey: after the start of the actuator, parts are discovered within less.
inline constexpr absl::Duration kSurveyTime = absl::Seconds(2);
// Between two readings of a part.
inline constexpr absl::Duration kSurveyPeriod = absl::Milliseconds(50);

struct ModeSurvey {
  std::string level;     // empty = no part shows one
  std::string observed;  // `/base=? /safety=HALT`
};

// Returns after kSurveyTime at most, or soon after `cancel` with what was read until then.
ModeSurvey SurveyModes(const std::vector<LevelSpec>& levels, PartModes& modes, const Clock& clock,
                       const CancelFlag& cancel);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_MODE_SURVEY_H_
