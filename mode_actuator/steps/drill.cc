#include "mode_actuator/steps/drill.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"

namespace rips::actuator {

bool Drill::HoldsAlarm(absl::string_view name) const {
  const Level* level = FindNamed(levels_, name);
  if (level == nullptr) return true;
  return std::any_of(level->enter.begin(), level->enter.end(),
                     [](const std::unique_ptr<LevelStep>& step) { return step->alarms(); });
}

DrillOutcome Drill::Run(const DrillJob& job, const CancelFlag& cancel,
                        const std::function<void()>& between) {
  DrillOutcome outcome;
  outcome.id = job.id;
  const Level* level = FindNamed(levels_, job.level);
  if (level == nullptr) {
    outcome.steps.push_back({.step = absl::StrCat("level ", ros2::Printable(job.level)),
                             .detail = "there is no such level",
                             .drilled = Drilled::kNot});
    return outcome;
  }
  LevelStep::DrillOptions options = {
      .alarmed = HoldsAlarm(job.held), .cancel = &cancel, .between = between};
  const int64_t end_ns = NowNs() + absl::ToInt64Nanoseconds(kDrillTime);
  for (const Level::Steps* steps : {&level->enter, &level->leave}) {
    for (const std::unique_ptr<LevelStep>& step : *steps) {
      if (between && !cancel.cancelled()) between();
      const int64_t began_ns = NowNs();
      StepResult result;
      if (cancel.cancelled()) {
        result = {.detail = "not tried: a level had to be applied", .drilled = Drilled::kNot};
      } else if (began_ns >= end_ns) {
        result = {.detail = absl::StrCat("not tried: the time for a drill, ",
                                         absl::FormatDuration(kDrillTime), ", was over"),
                  .drilled = Drilled::kNot};
      } else {
        options.left = absl::Nanoseconds(end_ns - began_ns);
        result = step->Drill(options);
      }
      result.step = absl::StrCat(steps == &level->leave ? "leave: " : "", step->Name());
      result.took_ms = static_cast<uint32_t>((NowNs() - began_ns) / kNanosPerMilli);
      outcome.steps.push_back(std::move(result));
    }
  }
  outcome.cancelled = cancel.cancelled();
  return outcome;
}

}  // namespace rips::actuator
