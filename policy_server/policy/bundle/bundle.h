// A policy, ready to run: the rule files of one directory compiled as one program. Immutable; the
// directory may change afterwards without effect.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_H_

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/policy/bundle/manifest.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "policy_server/policy/inspect/inspection_set.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/policy/levels/level_table.h"
#include "services/base/clock.h"

namespace rips::bundle {

inline constexpr char kManifestName[] = "manifest.yaml";
inline constexpr size_t kManifestBytesMax = 64 << 10;
// All rule files of a bundle together; a single one is limited by lang::kFileBytesMax.
inline constexpr size_t kBundleBytesMax = 16 << 20;

struct Bundle {
  // `sha256:` + 64 hex digits of the SHA-256 of this listing, files in the order of the manifest:
  //   rips-bundle 1\n
  //   manifest.yaml SHA256\n
  //   PATH SHA256\n        one line a rule file, then one a YARA file
  // So it changes whenever the manifest (which holds the hashes of plugins) or any of them does.
  std::string id;
  Manifest manifest;
  std::shared_ptr<const engine::CompiledPolicy> program;
  // What rules inspect messages with; null if they do not.
  std::shared_ptr<const inspect::InspectionSet> inspections;
  levels::LevelIndex start_level = 0;
  // Warnings of the compiler as lang::RenderPlaces; empty = none.
  std::string warnings;

  const levels::LevelTable& levels() const { return program->rules().levels; }
};

// Reads `dir`/manifest.yaml and the rule files it names, each once. Errors name the file and say
// what to do:
//   NotFound             the directory, the manifest or a rule file is not there
//   InvalidArgument      the manifest or the rules are wrong (of the rules: the places of all their
//                        diagnostics, nothing of their text, as errors end up in logs), the
//                        manifest's levels are not what the rules declare, a path leaves the
//                        directory or leads through a symbolic link
//   ResourceExhausted    a file or all together are too long
//   Unavailable          reading failed
// Plugins are started once to see how they want to be asked, which takes up to a second. `clock` is
// not owned and outlives the bundle's inspections, as does what `options` name.
absl::StatusOr<Bundle> LoadBundle(const std::string& dir, const Clock* clock,
                                  const inspect::InspectOptions& options = {});

// The id that the bundle in `dir` has, whether or not its rules are right: nothing of it is
// compiled or run. Errors of LoadBundle for files that cannot be read, and of the manifest.
absl::StatusOr<std::string> BundleIdOf(const std::string& dir);

// What there is to say of a bundle.
struct BundleCheck {
  // What its manifest calls it; empty if the manifest is refused.
  std::string name;
  // As Bundle::id; empty if the bundle is refused.
  std::string id;
  size_t rules = 0;
  size_t levels = 0;
  // The rule files that could be read, and what the compiler says of them if all could.
  std::vector<lang::SourceFile> files;
  std::vector<lang::Diagnostic> diagnostics;
  // Why it is refused, besides the errors among `diagnostics`. Those of a manifest's text are one
  // entry of several lines.
  std::vector<std::string> problems;
  // What is allowed and probably not meant: a name that is not the directory's; YARA files and
  // plugins that are listed and no rule names.
  std::vector<std::string> warnings;

  bool ok() const { return !id.empty(); }
};

// Refuses what LoadBundle refuses, but runs nothing: a plugin is only looked at and hashed.
BundleCheck CheckBundle(const std::string& dir);

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_BUNDLE_H_
