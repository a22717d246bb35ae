// Reading files of a bundle directory without being led out of it. Internal to this folder.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_FILES_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_FILES_H_

#include <cstddef>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/runtime/unique_fd.h"

namespace rips::bundle {

// Bytes of a path inside a bundle, and its components.
inline constexpr size_t kBundlePathBytesMax = 255;

// OK for a relative path of A-Z a-z 0-9 `.` `_` `-` and `/`, without empty, `.` or `..` components;
// else InvalidArgument that says what is wrong with it.
absl::Status CheckBundlePath(absl::string_view path);

// An open bundle directory. The directory itself may be reached through symbolic links; nothing
// inside it is.
class BundleDirectory {
 public:
  // NotFound or Unavailable.
  static absl::StatusOr<BundleDirectory> Open(const std::string& path);
  // The whole regular file. InvalidArgument: bad path, a symbolic link or not a regular file;
  // NotFound; ResourceExhausted: more than `bytes_max`; Unavailable: cannot be read.
  absl::StatusOr<std::string> Read(absl::string_view path, size_t bytes_max) const;

 private:
  explicit BundleDirectory(UniqueFd fd) : fd_(std::move(fd)) {}

  UniqueFd fd_;
};

// SHA-256 (FIPS 180-4) as 64 lower-case hex digits.
std::string Sha256Hex(absl::string_view bytes);

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_FILES_H_
