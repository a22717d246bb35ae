// Port: one step of a level. Each kind of step has its own room: system_mode, program, alarm,
// firewall.
//
// | kind        | is entered                | while the level holds | is drilled by               |
// |-------------|---------------------------|-----------------------|-----------------------------|
// | system_mode | in order, and read back   | read                  | a look                      |
// | firewall    | in order, and read back   | read, and renewed     | a look                      |
// | program     | beside the other programs | not looked at         | a run if it is marked       |
// |             | and alarms                |                       | `drill: true`; else a look  |
// | alarm       | beside the other programs | read back             | a flash if its device       |
// |             | and alarms                |                       | allows it; else a look      |
#ifndef RIPS_MODE_ACTUATOR_STEPS_PORT_LEVEL_STEP_H_
#define RIPS_MODE_ACTUATOR_STEPS_PORT_LEVEL_STEP_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/drop_watch.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/decide/receipt.h"
#include "services/base/clock.h"
#include "services/ros2/ros_name.h"

namespace rips {
class CancelFlag;
}

namespace rips::actuator {

struct StepReading {
  // OK: read back and found to be so. Else the exact reason.
  absl::Status status;
  // What was seen, `firewall=alert.nft`; empty = nothing worth telling.
  std::string observed;
  // A warning although it succeeded; empty mostly.
  std::string note;
  // Of a firewall.
  std::optional<DropCount> dropped;
};

// A step that is being entered or checked, with its retries. One thread at a time.
class StepAttempt {
 public:
  virtual ~StepAttempt() = default;

  // Continues; true when the attempt is over. Only a step that is entered in order blocks, until it
  // is over or soon after its CancelFlag.
  virtual bool Poll(int64_t now_ns) = 0;
  // Ends it soon, as failed; what has succeeded stays so.
  virtual void Cancel() {}

  // Once it is over.
  StepResult result;
  absl::Status status;
  // `/safety=ALERT`, `horn=on`, without spaces; empty = no target.
  std::string observed;
  // As StepReading::dropped.
  std::optional<DropCount> dropped;
};

// One thread at a time.
class LevelStep {
 public:
  struct EnterOptions {
    absl::Duration timeout;  // of one attempt; not the step's own: leaving has less time
    int retries = 0;
    // The levels of the transition; empty = not known.
    std::string level_from;
    std::string level_to;
    const CancelFlag* cancel = nullptr;  // outlives the attempt
  };
  struct DrillOptions {
    absl::Duration left;   // for this step
    bool alarmed = false;  // the level that is held has an alarm on: none is flashed
    const CancelFlag* cancel = nullptr;
    // What must be done often meanwhile; may be empty.
    std::function<void()> between;
  };

  explicit LevelStep(Step spec) : spec_(std::move(spec)) {}
  virtual ~LevelStep() = default;

  const Step& spec() const { return spec_; }
  // `system_mode /safety=ALERT`, `program usb_alarm`, `alarm relay-A1=on`,
  // `firewall /etc/rips/alert.nft`.
  virtual std::string Name() const = 0;
  // Entered one by one in the order of the file; the others run at the same time, after these.
  virtual bool in_order() const = 0;
  // Lets more through than before: a raise does not run it.
  virtual bool opens() const { return false; }
  // It can be seen or heard while its level holds.
  virtual bool alarms() const { return false; }

  virtual std::unique_ptr<StepAttempt> Enter(const EnterOptions& options, int64_t now_ns) = 0;
  // Call when that attempt is over.
  virtual void Entered(const StepAttempt&) {}
  // It has succeeded in this transition, and a retry of the level skips it.
  virtual bool done() const { return false; }
  // A level is entered anew: forgets what Entered and Left have kept.
  virtual void Forget() {}

  // Looks whether it is still so. Null if that cannot be seen.
  virtual std::unique_ptr<StepAttempt> Check(const CancelFlag& cancel, int64_t now_ns) = 0;
  // Of a check that is over: the level was left.
  virtual bool Left(const StepAttempt& check) { return !check.status.ok(); }

  // Tries it as far as that changes nothing. Name and time of the result are the caller's.
  virtual StepResult Drill(const DrillOptions& options) = 0;

 private:
  const Step spec_;
};

// `detail` describes a result whose status is OK; otherwise the message of the status does.
inline StepResult DrillResult(Drilled drilled, const absl::Status& status, std::string detail) {
  StepResult result;
  result.ok = status.ok();
  result.drilled = drilled;
  result.detail = status.ok() ? std::move(detail) : ros2::Printable(status.message());
  return result;
}

// Unimplemented: a kind of step that cannot be tried.
inline StepResult Looked(const absl::Status& status, std::string detail) {
  const bool tried = !absl::IsUnimplemented(status);
  return DrillResult(tried ? Drilled::kLooked : Drilled::kNot, status, std::move(detail));
}

// The attempt of a step that is entered in order: one call that blocks. One thread at a time.
class BlockingAttempt final : public StepAttempt {
 public:
  // `act` is called once, by the first Poll. `clock` is not owned and outlives this.
  BlockingAttempt(std::string name, const Clock* clock, std::function<StepReading()> act)
      : act_(std::move(act)), clock_(clock) {
    result.step = std::move(name);
  }

  bool Poll(int64_t now_ns) override {
    if (act_ == nullptr) return true;
    StepReading reading = std::exchange(act_, nullptr)();
    status = reading.status;
    observed = std::move(reading.observed);
    dropped = std::move(reading.dropped);
    result.ok = status.ok();
    result.detail = result.ok ? std::move(reading.note) : std::string(status.message());
    const int64_t took_ns = clock_->Now().boottime_ns - now_ns;
    result.took_ms = static_cast<uint32_t>(took_ns / kNanosPerMilli);
    return true;
  }

 private:
  std::function<StepReading()> act_;
  const Clock* const clock_;  // Not owned; outlives this.
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PORT_LEVEL_STEP_H_
