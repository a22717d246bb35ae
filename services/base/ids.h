// Names and ids that several programs agree on.
#ifndef RIPS_SERVICES_BASE_IDS_H_
#define RIPS_SERVICES_BASE_IDS_H_

#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace rips {

// True for the name of a robot, host or operator: [a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?
bool IsValidName(absl::string_view name);

// OK, or InvalidArgument "`R_1` is not a valid robot id; ..." where `what` is "robot id".
absl::Status ValidateName(absl::string_view what, absl::string_view name);

// 16 random bytes (getrandom) as 32 lower-case hex digits: the id of an alert, transition or
// command. Any thread.
std::string NewId();

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_IDS_H_
