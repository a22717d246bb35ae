// A step that runs beside others: a program or an alarm, with its retries.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PORT_STEP_ATTEMPT_H_
#define RIPS_MODE_ACTUATOR_STEPS_PORT_STEP_ATTEMPT_H_

#include <cstdint>

#include "mode_actuator/decide/receipt.h"

namespace rips::actuator {

// One thread at a time. Nothing blocks.
class StepAttempt {
 public:
  virtual ~StepAttempt() = default;

  // Goes on with it; true when it is over. Then `result` holds.
  virtual bool Poll(int64_t now_ns) = 0;
  // To be over soon, as failed; what has succeeded stays so.
  virtual void Cancel() = 0;

  StepResult result;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PORT_STEP_ATTEMPT_H_
