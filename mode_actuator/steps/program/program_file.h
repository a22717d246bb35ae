// The file of a program: only root can change it, and the file that was checked is the one run.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PROGRAM_PROGRAM_FILE_H_
#define RIPS_MODE_ACTUATOR_STEPS_PROGRAM_PROGRAM_FILE_H_

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {

// Of a file whose SHA-256 is asked for; it is read before each run.
inline constexpr size_t kHashedBytesMax = 64 << 20;

// OK if only root can change what `path` names: absolute, no `.` or `..`, every directory and
// the file itself owned by root, not writable by group or others, no symbolic link anywhere; the
// file regular and executable. `root_fd` is the directory that stands for `/`. NotFound or
// PermissionDenied, naming the component.
absl::Status CheckProgramPath(int root_fd, absl::string_view path);

// The file that CheckProgramPath found, open for reading: whatever `path` names later, it stays
// that one. PermissionDenied if it cannot be read.
absl::StatusOr<UniqueFd> OpenProgram(int root_fd, absl::string_view path);

// OK if the SHA-256 of the whole file is `sha256`, 64 lower case hexadecimal digits.
// PermissionDenied if it is another, or the file is longer than kHashedBytesMax,
// Unavailable if it cannot be read.
absl::Status CheckSha256(int fd, absl::string_view sha256);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PROGRAM_PROGRAM_FILE_H_
