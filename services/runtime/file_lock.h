// A lock file: of several processes one holds it, until it closes the descriptor or ends.
#ifndef RIPS_SERVICES_RUNTIME_FILE_LOCK_H_
#define RIPS_SERVICES_RUNTIME_FILE_LOCK_H_

#include <string>

#include "absl/status/statusor.h"
#include "services/runtime/unique_fd.h"

namespace rips {

// Makes the file `path` (mode 0600) if it is not there, and locks it.
//   FailedPrecondition: another process holds it
//   NotFound: its directory does not exist
//   Unavailable: it cannot be opened or locked
absl::StatusOr<UniqueFd> LockFile(const std::string& path);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_FILE_LOCK_H_
