// Replaces the content of a file of the operator's: rules, settings.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_REWRITE_FILE_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_REWRITE_FILE_H_

#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace rips::ripsctl {

// Atomically; keeps the file's mode. A symbolic link stays one: the file that it names is replaced.
// Errors name the path.
absl::Status RewriteFile(const std::string& path, absl::string_view text);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_REWRITE_FILE_H_
