// The bundles that the server keeps, pushed ones and copies of the directory's (bundle_keep.h).
#ifndef RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_LIBRARY_H_
#define RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_LIBRARY_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::rollout {

// Digits of an id that Find wants at least.
inline constexpr size_t kIdDigitsMin = 8;

struct KeptBundle {
  // `sha256:` + 64 hex digits.
  std::string id;
  // Of its manifest.
  std::string name;
  // Key that signed it; empty = none that the server knows.
  std::string signed_by;
  int64_t stored_unix_ns = 0;
  // Why it could not be activated; empty = nothing is known that speaks against it.
  std::string problem;
};

// What a bundle in a directory is, once it has been loaded as for a robot.
struct LoadedBundle {
  std::string id;
  std::string name;
  // Of the compiler, as text.
  std::string warnings;
};

// Add: one thread at a time; the others: any.
class BundleLibrary {
 public:
  // Loads what is in a directory, with all checks.
  using Load = std::function<absl::StatusOr<LoadedBundle>(const std::string& dir)>;
  // The key that signed the bundle of that id in a directory; empty: no known one. PermissionDenied
  // if the server wants one.
  using SignedBy =
      std::function<absl::StatusOr<std::string>(const std::string& dir, const std::string& id)>;

  BundleLibrary(std::string directory, Load load, SignedBy signed_by);

  struct Added {
    KeptBundle bundle;
    std::string warnings;
    // It was there already.
    bool known = false;
  };
  // A serialized BundleArchive of a peer. InvalidArgument: it is malformed, or the bundle is
  // refused; PermissionDenied: it is not signed as the server wants; ResourceExhausted,
  // Unavailable: it cannot be written. Then nothing of it is left.
  absl::StatusOr<Added> Add(absl::string_view archive);
  // The one stored last first. Unavailable.
  absl::StatusOr<std::vector<KeptBundle>> List() const;
  // By id, or at least the first kIdDigitsMin of its digits, with or without `sha256:`. NotFound,
  // InvalidArgument: too short, or several begin so.
  absl::StatusOr<KeptBundle> Find(absl::string_view id) const;

 private:
  // Has the kept copy's signature arrive, too, unless the one that was pushed is verified.
  absl::Status KeepSignature(const std::string& kept, const std::string& arriving,
                             const std::string& id) const;
  KeptBundle Describe(const std::string& path, const std::string& id) const;

  const std::string directory_;
  const Load load_;
  const SignedBy signed_by_;
};

}  // namespace rips::rollout

#endif  // RIPS_POLICY_SERVER_SERVER_ROLLOUT_BUNDLE_LIBRARY_H_
