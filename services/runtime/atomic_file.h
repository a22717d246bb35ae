// Small files read whole and replaced whole.
#ifndef RIPS_SERVICES_RUNTIME_ATOMIC_FILE_H_
#define RIPS_SERVICES_RUNTIME_ATOMIC_FILE_H_

#include <sys/types.h>

#include <cstddef>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips {

// Replaces `path` by `bytes` so that a crash or power cut at any point leaves the old or the new
// content, never a mixture: temporary file beside it, fsync, rename, fsync of the directory. When
// it returns OK the bytes are on the disk. One writer per path at a time.
absl::Status WriteFileAtomically(const std::string& path, absl::string_view bytes,
                                 mode_t mode = 0600);

// The whole regular file. NotFound, PermissionDenied, ResourceExhausted if it has more than
// `bytes_max` bytes, FailedPrecondition if it is no regular file, Unavailable for other errors.
absl::StatusOr<std::string> ReadFile(const std::string& path, size_t bytes_max);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_ATOMIC_FILE_H_
