// Results of drilled steps.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PORT_DRILLED_H_
#define RIPS_MODE_ACTUATOR_STEPS_PORT_DRILLED_H_

#include <string>
#include <utility>

#include "absl/status/status.h"
#include "mode_actuator/decide/receipt.h"
#include "services/ros2/ros_name.h"

namespace rips::actuator {

// `detail` is what people read if the status is OK; else they read its message.
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

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PORT_DRILLED_H_
