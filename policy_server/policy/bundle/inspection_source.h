// The YARA files and plugins of one bundle: only what its manifest lists, so that the bundle's id
// covers everything that judges.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_INSPECTION_SOURCE_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_INSPECTION_SOURCE_H_

#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/policy/bundle/manifest.h"
#include "policy_server/policy/inspect/file_source.h"

namespace rips::bundle {

// Bytes of a plugin's program.
inline constexpr size_t kPluginBytesMax = size_t{64} << 20;

class InspectionSource final : public inspect::FileSource {
 public:
  // `prefix` is what paths of files in `dir` begin with in diagnostics, perhaps nothing. Nothing is
  // owned, all outlive this.
  InspectionSource(const std::string& dir, const std::string& prefix,
                   const BundleDirectory& directory, const Manifest& manifest)
      : dir_(dir), prefix_(prefix), directory_(directory), manifest_(manifest) {}

  // FailedPrecondition: the manifest does not list it.
  absl::StatusOr<std::string> Read(absl::string_view path, size_t bytes_max) const override;
  // FailedPrecondition: the manifest does not list it, or it is not the program whose SHA-256 the
  // manifest gives.
  absl::StatusOr<std::string> ProgramPath(const lang::Inspection& plugin) const override;
  // The bundle.
  std::string ReadableRoot(absl::string_view path) const override;

 private:
  const std::string& dir_;
  const std::string& prefix_;
  const BundleDirectory& directory_;
  const Manifest& manifest_;
};

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_INSPECTION_SOURCE_H_
