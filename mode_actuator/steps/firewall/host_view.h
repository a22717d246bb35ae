// Port: what of this host and its servers must never be cut.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_HOST_VIEW_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_HOST_VIEW_H_

#include <vector>

#include "absl/status/statusor.h"
#include "mode_actuator/steps/firewall/target.h"

namespace rips::actuator {

// One thread at a time.
class HostView {
 public:
  virtual ~HostView() = default;

  // All servers, sorted, without duplicates. Unavailable while a name was never resolved.
  virtual absl::StatusOr<std::vector<ControlAddress>> Control() = 0;
  // As of now; `servers` are those of Control().
  virtual absl::StatusOr<KeptOpen> Kept() = 0;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_HOST_VIEW_H_
