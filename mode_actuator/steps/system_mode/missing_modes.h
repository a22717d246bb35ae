// Stands in for the robot's System Modes while there is no way to them: every step fails and says
// why, so that the other steps of a level (alarm, firewall, programs) are taken all the same.
#ifndef RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MISSING_MODES_H_
#define RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MISSING_MODES_H_

#include <utility>

#include "absl/status/status.h"
#include "mode_actuator/steps/port/part_modes.h"

namespace rips::actuator {

class MissingModes final : public PartModes {
 public:
  // Before use.
  void set_why(const absl::Status& why) { why_ = absl::UnavailableError(why.message()); }

  ModeReading Enter(absl::string_view, absl::string_view, absl::Duration, int,
                    const CancelFlag&) override {
    return {.status = why_};
  }
  ModeReading Check(absl::string_view, absl::string_view, const CancelFlag&) override {
    return {.status = why_};
  }
  ModeReading Probe(absl::string_view, absl::string_view, const CancelFlag&) override {
    return {.status = why_};
  }

 private:
  absl::Status why_ = absl::UnavailableError("there is no way to the System Modes");
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MISSING_MODES_H_
