#include "mode_actuator/steps/alarm/alarm_step.h"

#include <algorithm>
#include <optional>
#include <string>
#include <variant>

#include "absl/strings/str_cat.h"
#include "mode_actuator/steps/alarm/alarm_attempt.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {
namespace {

constexpr absl::Duration kDrillPoll = absl::Milliseconds(20);
constexpr AlarmState kOff = {};

class AlarmLevelStep final : public LevelStep {
 public:
  AlarmLevelStep(const Step& spec, bool flash_in_drills, Alarms* alarms, const Clock* clock)
      : LevelStep(spec),
        step_(std::get<AlarmStep>(spec.what)),
        flash_in_drills_(flash_in_drills),
        alarms_(alarms),
        clock_(clock) {}

  std::string Name() const override {
    return absl::StrCat("alarm ", step_.device, "=", ToString(step_.state));
  }
  bool in_order() const override { return false; }
  bool alarms() const override { return step_.state != kOff; }

  // Every retry of a level sets it again: that does no harm, and it may have been unplugged.
  std::unique_ptr<StepAttempt> Enter(const EnterOptions& options, int64_t now_ns) override {
    const AlarmAttempt::Options to = {.timeout = options.timeout, .retries = options.retries};
    return std::make_unique<AlarmAttempt>(step_, Name(), alarms_, to, now_ns);
  }
  void Entered(const StepAttempt& attempt) override {
    misread_ = absl::IsFailedPrecondition(attempt.status);
  }
  void Forget() override { misread_ = false; }

  std::unique_ptr<StepAttempt> Check(const CancelFlag&, int64_t now_ns) override {
    const AlarmAttempt::Options look = {.order = AlarmOrder::kRead, .timeout = kAlarmLookTime};
    return std::make_unique<AlarmAttempt>(step_, Name(), alarms_, look, now_ns);
  }
  bool Left(const StepAttempt& check) override {
    if (check.status.ok()) misread_ = false;
    if (check.status.ok()) return false;
    if (spec().on_failure != OnFailure::kContinue) return true;
    return absl::IsFailedPrecondition(check.status) && !misread_;
  }

  StepResult Drill(const DrillOptions& options) override;

 private:
  // Polls `attempt` to its end; a cancelled one ends soon.
  void Drive(StepAttempt& attempt, const CancelFlag& cancel) const {
    while (!attempt.Poll(NowNs())) {
      if (cancel.WaitFor(kDrillPoll)) attempt.Cancel();
    }
  }
  StepResult Flash(absl::Duration timeout, const CancelFlag& cancel);
  // Switches the alarm off; waits for it unless it is cancelled.
  absl::Status SwitchOff(absl::Duration timeout, const CancelFlag& cancel);
  int64_t NowNs() const { return clock_->Now().boottime_ns; }

  const AlarmStep step_;
  const bool flash_in_drills_;
  Alarms* const alarms_;      // Not owned; outlives this.
  const Clock* const clock_;  // Not owned; outlives this.
  // It did not read back as set right after it was set.
  bool misread_ = false;
};

StepResult AlarmLevelStep::Drill(const DrillOptions& options) {
  const absl::Duration timeout = std::min({spec().timeout, options.left, kDrillAlarmTime});
  AlarmAttempt look({step_.device, kOff}, Name(), alarms_,
                    {.order = AlarmOrder::kRead, .timeout = timeout}, NowNs());
  Drive(look, *options.cancel);
  // Of a device that answers: it is on, or its state is not known.
  const bool is_off = look.status.ok();
  if (!is_off && !absl::IsFailedPrecondition(look.status)) return Looked(look.status, "");
  const std::string seen = look.seen() == "?"
                               ? "it is plugged in; it cannot be read back"
                               : absl::StrCat("it answers: ", ros2::Printable(look.seen()));
  if (!flash_in_drills_ || step_.state == kOff) return Looked(absl::OkStatus(), seen);
  if (options.alarmed) {
    return Looked(absl::OkStatus(),
                  absl::StrCat(seen, "; not flashed: the level held has an alarm on"));
  }
  if (!is_off) {
    return Looked(absl::OkStatus(), absl::StrCat(seen, "; not flashed: it is not known to be off"));
  }
  return Flash(timeout, *options.cancel);
}

StepResult AlarmLevelStep::Flash(absl::Duration timeout, const CancelFlag& cancel) {
  AlarmAttempt on(step_, "", alarms_, {.timeout = timeout}, NowNs());
  Drive(on, cancel);
  if (on.status.ok()) cancel.WaitFor(kFlashTime);
  // Also if it is not known to have been switched on: the order may have had its effect.
  const absl::Status off = SwitchOff(timeout, cancel);
  StepResult result =
      DrillResult(Drilled::kDone, on.status,
                  absl::StrCat("flashed ", ToString(step_.state),
                               ", then off again: ", ros2::Printable(on.result.detail)));
  if (off.ok()) return result;
  absl::StrAppend(
      &result.detail, result.detail.empty() ? "" : "; ",
      "IT MAY STILL BE ON, it could not be switched off: ", ros2::Printable(off.message()));
  result.ok = false;
  return result;
}

absl::Status AlarmLevelStep::SwitchOff(absl::Duration timeout, const CancelFlag& cancel) {
  absl::Status status;
  for (int tries = 0; tries < 3; ++tries) {
    const absl::StatusOr<uint64_t> order = alarms_->Begin(step_.device, AlarmOrder::kSet, kOff);
    if (!order.ok()) return order.status();
    const int64_t end_ns = NowNs() + absl::ToInt64Nanoseconds(timeout);
    std::optional<AlarmResult> ended;
    while (!(ended = alarms_->Poll(*order)).has_value()) {
      if (cancel.cancelled() || NowNs() >= end_ns) {
        // The order is still carried out, before any order of a level to this device.
        alarms_->Leave(*order);
        return cancel.cancelled() ? absl::CancelledError("a level had to be applied")
                                  : absl::DeadlineExceededError("it does not answer");
      }
      cancel.WaitFor(kDrillPoll);
    }
    status = ended->status;
    if (status.ok() || cancel.WaitFor(kAlarmRetryPause)) return status;
  }
  // Once more, when it answers again.
  const absl::StatusOr<uint64_t> last = alarms_->Begin(step_.device, AlarmOrder::kSet, kOff);
  if (last.ok()) alarms_->Leave(*last);
  return status;
}

}  // namespace

std::unique_ptr<LevelStep> MakeAlarmStep(const Step& spec, bool flash_in_drills, Alarms* alarms,
                                         const Clock* clock) {
  return std::make_unique<AlarmLevelStep>(spec, flash_in_drills, alarms, clock);
}

}  // namespace rips::actuator
