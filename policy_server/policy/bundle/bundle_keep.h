// Copies of the bundles that were accepted, so that a robot's last good policy is there when its
// source is broken: DIR/<64 hex digits of the id>/, whole or not at all.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_KEEP_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_KEEP_H_

#include <cstddef>
#include <set>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::bundle {

// Copies that no robot uses any more; beyond, those made first are removed.
inline constexpr size_t kUnusedKeptMax = 16;

// Where the copy of the bundle `id` (as Bundle::id) is or would be. InvalidArgument for no id.
absl::StatusOr<std::string> KeptBundlePath(const std::string& keep_dir, absl::string_view id);

// Any thread; one at a time within the process.

// Copies the files that the manifest in `dir` lists, synced to the disk, unless the copy is there
// and whole; and its signature, which replaces the copy's: a bundle may be signed later, or anew. A
// copy's signature is never removed. Aborted: what is in `dir` is not `id` (any more). Unavailable
// or ResourceExhausted: it cannot be written. Errors of LoadBundle for files that cannot be read;
// if only the signature cannot, the copy is made without it.
absl::Status KeepBundle(const std::string& dir, absl::string_view id, const std::string& keep_dir);

// Removes copies beyond kUnusedKeptMax that are not `in_use`, and what was left half made.
void ForgetBundles(const std::string& keep_dir, const std::set<std::string>& in_use);

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_KEEP_H_
