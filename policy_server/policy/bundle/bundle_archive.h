// A bundle in one piece, as it is pushed to a server: a serialized rips.v1.BundleArchive.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_ARCHIVE_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_ARCHIVE_H_

#include <cstddef>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::bundle {

// Bytes of an archive.
inline constexpr size_t kArchiveBytesMax = size_t{96} << 20;

// The files that the manifest in `dir` lists: the manifest, rule files, YARA files, programs of
// plugins; then the signature if there is one. Does not check the rules. ResourceExhausted: a file
// is, or all together are, too large. Other errors of LoadBundle for files that cannot be read.
absl::StatusOr<std::string> PackBundle(const std::string& dir);

// Writes the files of an untrusted archive into `dir`, which is not there yet, and syncs them. The
// archive must begin with the manifest, and have each file that it lists once, perhaps a signature,
// and nothing else. On an error nothing of `dir` is left. Does not check the rules, nor whether the
// signature fits: call CheckBundle and SignerKeys::Verify.
//   InvalidArgument      the archive is malformed, or one of its files is not what it may be; names
//                        the file
//   AlreadyExists        `dir` is there; it is left as it is
//   ResourceExhausted    no room on the disk
//   Unavailable          it cannot be written
absl::Status UnpackBundle(absl::string_view archive, const std::string& dir);

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_ARCHIVE_H_
