// The attempt of a step that is entered in order: one call that blocks.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PORT_BLOCKING_ATTEMPT_H_
#define RIPS_MODE_ACTUATOR_STEPS_PORT_BLOCKING_ATTEMPT_H_

#include <cstdint>
#include <functional>
#include <string>
#include <utility>

#include "mode_actuator/steps/port/level_step.h"
#include "services/base/clock.h"

namespace rips::actuator {

// One thread at a time.
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

#endif  // RIPS_MODE_ACTUATOR_STEPS_PORT_BLOCKING_ATTEMPT_H_
