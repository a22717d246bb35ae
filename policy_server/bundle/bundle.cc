#include "policy_server/bundle/bundle.h"

#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/bundle/bundle_files.h"
#include "policy_server/bundle/inspection_source.h"
#include "policy_server/inspect/checked_files.h"
#include "policy_server/lang/compile.h"
#include "policy_server/lang/limits.h"
#include "services/base/status_macros.h"

namespace rips::bundle {
namespace {

constexpr char kManifestName[] = "manifest.yaml";

absl::Status InContext(const std::string& dir, const absl::Status& status) {
  return absl::Status(status.code(), absl::StrCat("bundle `", dir, "`: ", status.message()));
}

absl::StatusOr<std::vector<lang::SourceFile>> ReadRuleFiles(const std::string& dir,
                                                            const BundleDirectory& directory,
                                                            const Manifest& manifest) {
  std::vector<lang::SourceFile> files;
  size_t total_bytes = 0;
  for (const std::string& path : manifest.rules) {
    absl::StatusOr<std::string> text = directory.Read(path, lang::kFileBytesMax);
    if (!text.ok()) return InContext(dir, text.status());
    total_bytes += text->size();
    if (total_bytes > kBundleBytesMax) {
      return InContext(dir, absl::ResourceExhaustedError(
                                absl::StrCat("the rule files have more than ", kBundleBytesMax,
                                             " bytes together; split the policy")));
    }
    // Diagnostics name the file as the author finds it.
    files.push_back({.path = absl::StrCat(dir, "/", path), .text = *std::move(text)});
  }
  return files;
}

absl::StatusOr<std::string> BundleId(absl::string_view manifest_text, const Manifest& manifest,
                                     const std::vector<lang::SourceFile>& files,
                                     const BundleDirectory& directory) {
  std::string listing =
      absl::StrCat("rips-bundle 1\n", kManifestName, " ", Sha256Hex(manifest_text), "\n");
  for (size_t i = 0; i < files.size(); ++i) {
    absl::StrAppend(&listing, manifest.rules[i], " ", Sha256Hex(files[i].text), "\n");
  }
  for (const std::string& path : manifest.yara) {
    RIPS_ASSIGN_OR_RETURN(const std::string text, directory.Read(path, kBundleBytesMax));
    absl::StrAppend(&listing, path, " ", Sha256Hex(text), "\n");
  }
  // Plugins are in the manifest, with their hashes.
  return absl::StrCat("sha256:", Sha256Hex(listing));
}

}  // namespace

absl::StatusOr<Bundle> LoadBundle(const std::string& dir, const Clock* clock) {
  absl::StatusOr<BundleDirectory> directory = BundleDirectory::Open(dir);
  if (!directory.ok()) return InContext(dir, directory.status());
  absl::StatusOr<std::string> manifest_text = directory->Read(kManifestName, kManifestBytesMax);
  if (!manifest_text.ok()) return InContext(dir, manifest_text.status());

  Bundle bundle;
  RIPS_ASSIGN_OR_RETURN(bundle.manifest,
                        ParseManifest(absl::StrCat(dir, "/", kManifestName), *manifest_text));
  RIPS_ASSIGN_OR_RETURN(std::vector<lang::SourceFile> files,
                        ReadRuleFiles(dir, *directory, bundle.manifest));

  const InspectionSource source(dir, *directory, bundle.manifest);
  inspect::CheckedFiles checked(&source);
  lang::CompileResult compiled =
      lang::Compile(files, {.dialect = bundle.manifest.dialect, .inspection_files = &checked});
  std::string diagnostics = lang::RenderText(files, compiled.diagnostics);
  if (!compiled.rules.has_value()) return absl::InvalidArgumentError(diagnostics);
  const std::vector<std::string> declared = compiled.rules->levels.names();
  if (declared != bundle.manifest.levels) {
    return InContext(dir, absl::InvalidArgumentError(absl::StrCat(
                              "manifest says levels [", absl::StrJoin(bundle.manifest.levels, ", "),
                              "], the rule files declare [", absl::StrJoin(declared, ", "),
                              "]; make them equal, least restrictive first")));
  }
  bundle.start_level = *compiled.rules->levels.Find(bundle.manifest.start_level);
  bundle.warnings = std::move(diagnostics);
  if (!compiled.rules->inspections.empty()) {
    RIPS_ASSIGN_OR_RETURN(bundle.inspections, inspect::LoadInspections(compiled.rules->inspections,
                                                                       checked, {}, clock));
  }
  RIPS_ASSIGN_OR_RETURN(
      bundle.program,
      engine::Program::Create(*std::move(compiled.rules),
                              {.on_inspection_error = bundle.manifest.on_inspection_error}));
  absl::StatusOr<std::string> id = BundleId(*manifest_text, bundle.manifest, files, *directory);
  if (!id.ok()) return InContext(dir, id.status());
  bundle.id = *std::move(id);
  return bundle;
}

}  // namespace rips::bundle
