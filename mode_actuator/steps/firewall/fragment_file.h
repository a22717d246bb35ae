// Reading the file of a `firewall: {file: ...}` step.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FRAGMENT_FILE_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FRAGMENT_FILE_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "mode_actuator/steps/firewall/fragment.h"

namespace rips::actuator {

// PermissionDenied unless `path` is a file (no symbolic link) owned by root, or by whom this
// process runs as, that nobody else can write; NotFound, Unavailable; InvalidArgument as
// ParseFragment.
absl::StatusOr<std::vector<FragmentRule>> ReadFragment(const std::string& path);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FRAGMENT_FILE_H_
