// Port: bringing a part of the robot into a mode, and seeing whether it is there.
#ifndef RIPS_MODE_ACTUATOR_MODES_PART_MODES_H_
#define RIPS_MODE_ACTUATOR_MODES_PART_MODES_H_

#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/cancel_flag.h"

namespace rips::actuator {

struct ModeReading {
  // OK: read back and found to be so. Else what was found instead, part by part.
  absl::Status status;
  // The mode the robot says it is in; `?` if it does not say.
  std::string observed = "?";
  // What people should know although it went well; empty mostly.
  std::string note = {};
};

// One thread at a time.
class PartModes {
 public:
  virtual ~PartModes() = default;

  // Orders `mode` and waits until it is read back: 1 + `retries` attempts of `timeout` each.
  // InvalidArgument if the robot refuses the order (no use to try again), Cancelled, Unavailable
  // if nobody takes the order, DeadlineExceeded if the mode was not reached.
  virtual ModeReading Enter(absl::string_view part, absl::string_view mode, absl::Duration timeout,
                            int retries, const CancelFlag& cancel) = 0;

  // Looks once. FailedPrecondition if `part` is in another mode.
  virtual ModeReading Check(absl::string_view part, absl::string_view mode,
                            const CancelFlag& cancel) = 0;

  // Looks whether Enter could work now, and orders nothing: OK if all that it needs answers and
  // knows the mode. Unavailable or FailedPrecondition saying who does not, Cancelled;
  // Unimplemented if it cannot be told.
  virtual ModeReading Probe(absl::string_view, absl::string_view, const CancelFlag&) {
    return {.status = absl::UnimplementedError("not tried: a mode can only be ordered")};
  }
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_MODES_PART_MODES_H_
