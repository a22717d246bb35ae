// The files that make up a bundle: which ones, how large they may be, and with what mode a copy of
// them is written. Internal to this folder.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_CONTENTS_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_CONTENTS_H_

#include <sys/types.h>

#include <cstddef>
#include <string>
#include <vector>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/bundle/manifest.h"

namespace rips::bundle {

// Of a copy of each file but plugins, which may run as another user; the process's umask applies.
inline constexpr mode_t kContentMode = 0640;

struct ContentFile {
  // Inside the bundle.
  std::string path;
  size_t bytes_max = 0;
  mode_t mode = kContentMode;
};

// The manifest, then rule files, YARA files and programs of plugins, each path once. A path of
// several kinds has the smallest limit of them, and a plugin's mode. The signature is not listed.
std::vector<ContentFile> ListContents(const Manifest& manifest);

// Gives `take` each file that the manifest in `dir` lists, in that order; stops at its first error.
// Errors of LoadBundle for files that cannot be read.
absl::Status ReadContents(
    const std::string& dir,
    absl::FunctionRef<absl::Status(const ContentFile& file, std::string bytes)> take);

// Writes `file` below `dir`, where it is not yet, with the directories above it, and syncs it.
// ResourceExhausted: no room on the disk; Unavailable: other errors.
absl::Status WriteContent(const std::string& dir, const ContentFile& file, absl::string_view bytes);

// Syncs `dir` and the directories in it, so that the files in them are found after a power cut.
absl::Status SyncDirectories(const std::string& dir);
absl::Status SyncPath(const std::string& path);

// "`doing` `path`: ..." for an errno: ResourceExhausted if there is no room, else Unavailable.
absl::Status FileError(int error, absl::string_view doing, const std::string& path);

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_CONTENTS_H_
