// Port: carrying out firewall steps.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PORT_FIREWALL_CONTROL_H_
#define RIPS_MODE_ACTUATOR_STEPS_PORT_FIREWALL_CONTROL_H_

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/level_step.h"

namespace rips {
class CancelFlag;
}

namespace rips::actuator {

// One thread at a time.
class FirewallControl {
 public:
  virtual ~FirewallControl() = default;

  // Does what `step` says and reads it back: 1 + `retries` attempts of `timeout` each (not
  // step.timeout: leaving has less time). InvalidArgument and PermissionDenied are final; Cancelled
  // soon after `cancel`.
  virtual StepReading Enter(const Step& step, absl::Duration timeout, int retries,
                            const CancelFlag& cancel) = 0;

  // Looks once, and renews what would end by itself. FailedPrecondition if it is not so any more.
  virtual StepReading Check(const Step& step, const CancelFlag& cancel) = 0;

  // Checks whether Enter would succeed now; changes nothing. Unimplemented if that is not known.
  virtual StepReading Drill(const Step&, const CancelFlag&) {
    return {.status = absl::UnimplementedError("not tried: such a step can only be carried out"),
            .observed = {},
            .note = {}};
  }
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PORT_FIREWALL_CONTROL_H_
