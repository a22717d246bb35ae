#include "mode_actuator/steps/drill.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <utility>
#include <variant>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "mode_actuator/steps/alarm/alarm_attempt.h"
#include "mode_actuator/steps/level_executor.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {
namespace {

constexpr absl::Duration kDrillPoll = absl::Milliseconds(20);
// After its deadline a program is told to end, and killed kTermGrace later; then it must be over.
constexpr absl::Duration kDrillEndGrace = absl::Seconds(2);
constexpr AlarmState kOff = {};

StepResult Result(Drilled drilled, const absl::Status& status, std::string detail) {
  StepResult result;
  result.ok = status.ok();
  result.drilled = drilled;
  result.detail = status.ok() ? std::move(detail) : ros2::Printable(status.message());
  return result;
}

StepResult Looked(const absl::Status& status, std::string detail) {
  // A kind of step that cannot be tried says so by this code.
  const bool tried = !absl::IsUnimplemented(status);
  return Result(tried ? Drilled::kLooked : Drilled::kNot, status, std::move(detail));
}

// Polls `attempt` to its end; a cancelled one ends soon.
void Drive(StepAttempt& attempt, const Clock& clock, const CancelFlag& cancel) {
  while (!attempt.Poll(clock.Now().boottime_ns)) {
    if (cancel.WaitFor(kDrillPoll)) attempt.Cancel();
  }
}

}  // namespace

// Where a program's result arrives from the runner's thread.
class Drill::ResultSlot {
 public:
  void Set(ProgramResult result) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    result_ = std::move(result);
  }
  std::optional<ProgramResult> Take() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return std::exchange(result_, std::nullopt);
  }

 private:
  Mutex mu_;
  std::optional<ProgramResult> result_ ABSL_GUARDED_BY(mu_);
};

const LevelSpec* Drill::Find(absl::string_view name) const {
  const auto level = std::find_if(robot_.levels->begin(), robot_.levels->end(),
                                  [&](const LevelSpec& each) { return each.name == name; });
  return level == robot_.levels->end() ? nullptr : &*level;
}

bool Drill::HoldsAlarm(absl::string_view name) const {
  const LevelSpec* level = Find(name);
  // What is not known might be on.
  if (level == nullptr) return true;
  return std::any_of(level->enter.begin(), level->enter.end(), [](const Step& step) {
    const auto* alarm = std::get_if<AlarmStep>(&step.what);
    return alarm != nullptr && alarm->state != kOff;
  });
}

DrillOutcome Drill::Run(const DrillJob& job, const CancelFlag& cancel,
                        const std::function<void()>& between) {
  DrillOutcome outcome;
  outcome.id = job.id;
  const LevelSpec* level = Find(job.level);
  if (level == nullptr) {
    outcome.steps.push_back({.step = absl::StrCat("level ", ros2::Printable(job.level)),
                             .detail = "there is no such level",
                             .drilled = Drilled::kNot});
    return outcome;
  }
  alarmed_ = HoldsAlarm(job.held);
  between_ = between;
  const int64_t end_ns = NowNs() + absl::ToInt64Nanoseconds(kDrillTime);
  for (const std::vector<Step>* steps : {&level->enter, &level->leave}) {
    for (const Step& step : *steps) {
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
        result = Try(step, absl::Nanoseconds(end_ns - began_ns), cancel);
      }
      result.step = absl::StrCat(steps == &level->leave ? "leave: " : "", StepName(step));
      result.took_ms = static_cast<uint32_t>((NowNs() - began_ns) / kNanosPerMilli);
      outcome.steps.push_back(std::move(result));
    }
  }
  outcome.cancelled = cancel.cancelled();
  return outcome;
}

StepResult Drill::Try(const Step& step, absl::Duration left, const CancelFlag& cancel) {
  if (const auto* mode = std::get_if<SystemModeStep>(&step.what)) {
    const ModeReading reading = robot_.modes->Probe(mode->part, mode->mode, cancel);
    return Looked(reading.status, absl::StrCat("its manager and parts answer; it is in ",
                                               ros2::Printable(reading.observed)));
  }
  if (std::holds_alternative<ProgramStep>(step.what)) return TryProgram(step, left, cancel);
  if (std::holds_alternative<AlarmStep>(step.what)) return TryAlarm(step, left, cancel);
  const StepReading reading = robot_.firewall->Drill(step, cancel);
  return Looked(reading.status, ros2::Printable(reading.note));
}

StepResult Drill::TryProgram(const Step& step, absl::Duration left, const CancelFlag& cancel) {
  const std::string& name = std::get<ProgramStep>(step.what).name;
  const auto spec = std::find_if(robot_.allowed->begin(), robot_.allowed->end(),
                                 [&](const ProgramSpec& each) { return each.name == name; });
  if (spec != robot_.allowed->end() && spec->drill) return RunProgram(step, left, cancel);
  return Looked(robot_.programs->Examine(name), "it is there, and safe to run");
}

StepResult Drill::RunProgram(const Step& step, absl::Duration left, const CancelFlag& cancel) {
  const auto& program = std::get<ProgramStep>(step.what);
  ProgramRequest request;
  request.name = program.name;
  request.args = program.args;
  request.timeout = std::min(step.timeout, left);
  request.drill = true;
  const auto slot = std::make_shared<ResultSlot>();
  const absl::StatusOr<uint64_t> run =
      robot_.programs->Start(request, [slot](ProgramResult ended) { slot->Set(std::move(ended)); });
  if (!run.ok()) return Result(Drilled::kNot, run.status(), "");
  const int64_t end_ns = NowNs() + absl::ToInt64Nanoseconds(request.timeout + kDrillEndGrace);
  const std::optional<ProgramResult> ended = AwaitProgram(*run, slot, end_ns, cancel);
  if (!ended.has_value()) {
    return Result(Drilled::kDone, absl::DeadlineExceededError("the program runner gave no result"),
                  "");
  }
  StepResult result = Result(ended->begun ? Drilled::kDone : Drilled::kNot, ended->status,
                             "run as a drill; it exited with 0");
  const std::string& output = ended->output_tail;
  result.output_tail = output.substr(output.size() - std::min(output.size(), kStepOutputBytesMax));
  return result;
}

std::optional<ProgramResult> Drill::AwaitProgram(uint64_t run,
                                                 const std::shared_ptr<ResultSlot>& slot,
                                                 int64_t end_ns, const CancelFlag& cancel) {
  const CancelFlag own;
  bool told = false;
  while (NowNs() < end_ns) {
    if (std::optional<ProgramResult> ended = slot->Take()) return ended;
    if (cancel.cancelled() && !std::exchange(told, true)) robot_.programs->Cancel(run);
    // What looks at the level, and renews its rules, does not wait for a slow program.
    if (between_ && !told) between_();
    // A cancelled flag does not sleep, so what is told to end is waited for on a flag of our own.
    (told ? own : cancel).WaitFor(kDrillPoll);
  }
  robot_.programs->Cancel(run);
  return slot->Take();
}

StepResult Drill::TryAlarm(const Step& step, absl::Duration left, const CancelFlag& cancel) {
  const auto& alarm = std::get<AlarmStep>(step.what);
  const absl::Duration timeout = std::min({step.timeout, left, kDrillAlarmTime});
  AlarmAttempt look({alarm.device, kOff}, StepName(step), robot_.alarms,
                    {.order = AlarmOrder::kLook, .timeout = timeout}, NowNs());
  Drive(look, *robot_.clock, cancel);
  // Of a device that answers: it is on, or nobody knows.
  const bool is_off = look.status().ok();
  if (!is_off && !absl::IsFailedPrecondition(look.status())) return Looked(look.status(), "");
  const std::string seen = look.observed() == "?"
                               ? "it is plugged in; it cannot be read back"
                               : absl::StrCat("it answers: ", ros2::Printable(look.observed()));
  const auto device =
      std::find_if(robot_.devices->begin(), robot_.devices->end(),
                   [&](const AlarmSpec& each) { return each.name == alarm.device; });
  if (device == robot_.devices->end() || !device->flash_in_drills || alarm.state == kOff) {
    return Looked(absl::OkStatus(), seen);
  }
  if (alarmed_) {
    return Looked(absl::OkStatus(),
                  absl::StrCat(seen, "; not flashed: the level held has an alarm on"));
  }
  if (!is_off) {
    return Looked(absl::OkStatus(), absl::StrCat(seen, "; not flashed: it is not known to be off"));
  }
  return Flash(alarm, timeout, cancel);
}

StepResult Drill::Flash(const AlarmStep& alarm, absl::Duration timeout, const CancelFlag& cancel) {
  AlarmAttempt on(alarm, "", robot_.alarms, {.timeout = timeout}, NowNs());
  Drive(on, *robot_.clock, cancel);
  if (on.status().ok()) cancel.WaitFor(kFlashTime);
  // Also if it is not known to have been switched on: the order may have had its effect.
  const absl::Status off = SwitchOff(alarm.device, timeout, cancel);
  StepResult result = Result(Drilled::kDone, on.status(),
                             absl::StrCat("flashed ", ToString(alarm.state),
                                          ", then off again: ", ros2::Printable(on.result.detail)));
  if (off.ok()) return result;
  absl::StrAppend(
      &result.detail, result.detail.empty() ? "" : "; ",
      "IT MAY STILL BE ON, it could not be told to be off: ", ros2::Printable(off.message()));
  result.ok = false;
  return result;
}

absl::Status Drill::SwitchOff(const std::string& device, absl::Duration timeout,
                              const CancelFlag& cancel) {
  absl::Status status;
  for (int tries = 0; tries < 3; ++tries) {
    const absl::StatusOr<uint64_t> order = robot_.alarms->Begin(device, AlarmOrder::kSet, kOff);
    if (!order.ok()) return order.status();
    const int64_t end_ns = NowNs() + absl::ToInt64Nanoseconds(timeout);
    std::optional<AlarmResult> ended;
    while (!(ended = robot_.alarms->Poll(*order)).has_value()) {
      if (cancel.cancelled() || NowNs() >= end_ns) {
        // It is carried out all the same, before what a level tells this device.
        robot_.alarms->Leave(*order);
        return cancel.cancelled() ? absl::CancelledError("a level had to be applied")
                                  : absl::DeadlineExceededError("it does not answer");
      }
      cancel.WaitFor(kDrillPoll);
    }
    status = ended->status;
    if (status.ok() || cancel.WaitFor(kAlarmRetryPause)) return status;
  }
  // Once more, when it answers again.
  const absl::StatusOr<uint64_t> last = robot_.alarms->Begin(device, AlarmOrder::kSet, kOff);
  if (last.ok()) robot_.alarms->Leave(*last);
  return status;
}

}  // namespace rips::actuator
