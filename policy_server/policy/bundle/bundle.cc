#include "policy_server/policy/bundle/bundle.h"

#include <algorithm>
#include <filesystem>
#include <optional>
#include <system_error>
#include <utility>

#include "absl/container/btree_map.h"
#include "absl/functional/function_ref.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/bundle/bundle_contents.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/policy/bundle/inspection_source.h"
#include "policy_server/policy/inspect/checked_files.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/policy/lang/limits.h"
#include "services/base/status_macros.h"

namespace rips::bundle {
namespace {

absl::Status InContext(const std::string& dir, const absl::Status& status) {
  return absl::Status(status.code(), absl::StrCat("bundle `", dir, "`: ", status.message()));
}

// What names of files in `dir` begin with: as lang::Inspection::path writes paths.
std::string PrefixOf(const std::string& dir) {
  std::string prefix = std::filesystem::path(dir).lexically_normal().string();
  if (prefix == "." || prefix == "./") return "";
  if (!prefix.empty() && prefix.back() != '/') prefix.push_back('/');
  return prefix;
}

// `hash_of`: of the file of that path. Plugins are in the manifest, with their hashes.
std::string IdOf(const Manifest& manifest,
                 absl::FunctionRef<std::string(const std::string& path)> hash_of) {
  std::string listing =
      absl::StrCat("rips-bundle 1\n", kManifestName, " ", hash_of(kManifestName), "\n");
  for (const std::vector<std::string>* paths : {&manifest.rules, &manifest.yara}) {
    for (const std::string& path : *paths) {
      absl::StrAppend(&listing, path, " ", hash_of(path), "\n");
    }
  }
  return absl::StrCat("sha256:", Sha256Hex(listing));
}

absl::StatusOr<std::string> BundleId(absl::string_view manifest_text, const Manifest& manifest,
                                     const std::vector<lang::SourceFile>& files,
                                     const BundleDirectory& directory) {
  absl::btree_map<std::string, std::string> hashes = {{kManifestName, Sha256Hex(manifest_text)}};
  for (const std::string& path : manifest.yara) {
    RIPS_ASSIGN_OR_RETURN(const std::string text, directory.Read(path, kBundleBytesMax));
    hashes[path] = Sha256Hex(text);
  }
  for (size_t i = 0; i < files.size(); ++i) hashes[manifest.rules[i]] = Sha256Hex(files[i].text);
  return IdOf(manifest, [&](const std::string& path) { return hashes[path]; });
}

// A bundle as it was read, once, and judged without running anything.
class Reading {
 public:
  // `dir` is not owned and outlives this.
  explicit Reading(const std::string& dir)
      : dir_(dir), prefix_(PrefixOf(dir)), directory_(BundleDirectory::Open(dir)) {
    absl::Status read = ReadManifest();
    if (read.ok()) {
      ReadRuleFiles();
      if (problems_.empty()) read = Compile();
    }
    if (!read.ok()) problems_.push_back(std::move(read));
  }
  Reading(const Reading&) = delete;
  Reading& operator=(const Reading&) = delete;

  bool ok() const { return !id_.empty(); }
  // Empty if it was ok, or if it is for the errors of the compiler that it was not.
  const std::vector<absl::Status>& problems() const { return problems_; }
  const std::vector<lang::SourceFile>& files() const { return files_; }
  const std::vector<lang::Diagnostic>& diagnostics() const { return diagnostics_; }
  const Manifest& manifest() const { return manifest_; }

  // Only if it was ok.
  const std::string& id() const { return id_; }
  const std::shared_ptr<const engine::CompiledPolicy>& program() const { return program_; }
  inspect::CheckedFiles& checked() { return *checked_; }
  std::vector<std::string> Unused() const;

 private:
  absl::Status ReadManifest();
  void ReadRuleFiles();
  absl::Status Compile();

  const std::string& dir_;
  const std::string prefix_;
  const absl::StatusOr<BundleDirectory> directory_;
  std::string manifest_text_;
  Manifest manifest_;
  std::vector<lang::SourceFile> files_;
  std::optional<InspectionSource> source_;
  std::optional<inspect::CheckedFiles> checked_;
  std::vector<lang::Diagnostic> diagnostics_;
  std::shared_ptr<const engine::CompiledPolicy> program_;
  std::string id_;
  std::vector<absl::Status> problems_;
};

absl::Status Reading::ReadManifest() {
  if (!directory_.ok()) return InContext(dir_, directory_.status());
  absl::StatusOr<std::string> text = directory_->Read(kManifestName, kManifestBytesMax);
  if (!text.ok()) return InContext(dir_, text.status());
  manifest_text_ = *std::move(text);
  RIPS_ASSIGN_OR_RETURN(manifest_,
                        ParseManifest(absl::StrCat(prefix_, kManifestName), manifest_text_));
  return absl::OkStatus();
}

void Reading::ReadRuleFiles() {
  size_t total_bytes = 0;
  for (const std::string& path : manifest_.rules) {
    absl::StatusOr<std::string> text = directory_->Read(path, lang::kFileBytesMax);
    if (!text.ok()) {
      problems_.push_back(InContext(dir_, text.status()));
      continue;
    }
    total_bytes += text->size();
    if (total_bytes > kBundleBytesMax) {
      problems_.push_back(InContext(dir_, absl::ResourceExhaustedError(absl::StrCat(
                                              "the rule files have more than ", kBundleBytesMax,
                                              " bytes together; split the policy"))));
      return;
    }
    // Diagnostics name the file as the author finds it.
    files_.push_back({.path = absl::StrCat(prefix_, path), .text = *std::move(text)});
  }
}

absl::Status Reading::Compile() {
  source_.emplace(dir_, prefix_, *directory_, manifest_);
  checked_.emplace(&*source_);
  lang::CompileResult compiled =
      lang::Compile(files_, {.dialect = manifest_.dialect, .inspection_files = &*checked_});
  diagnostics_ = std::move(compiled.diagnostics);
  if (!compiled.rules.has_value()) return absl::OkStatus();
  const std::vector<std::string> declared = compiled.rules->levels.names();
  if (declared != manifest_.levels) {
    return InContext(dir_, absl::InvalidArgumentError(absl::StrCat(
                               "manifest says levels [", absl::StrJoin(manifest_.levels, ", "),
                               "], the rule files declare [", absl::StrJoin(declared, ", "),
                               "]; make them equal, least restrictive first")));
  }
  for (const std::string& level : manifest_.two_person) {
    if (!compiled.rules->levels.at(*compiled.rules->levels.Find(level)).soft) continue;
    return InContext(
        dir_,
        absl::InvalidArgumentError(absl::StrCat(
            "two_person lists `", level, "`, which the rule files declare `soft`: a rule may ",
            "lower it with no person at all; take it out of two_person, or remove `soft`")));
  }
  absl::StatusOr<std::string> id = BundleId(manifest_text_, manifest_, files_, *directory_);
  if (!id.ok()) return InContext(dir_, id.status());
  RIPS_ASSIGN_OR_RETURN(
      program_, engine::CompiledPolicy::Create(
                    *std::move(compiled.rules),
                    {.on_inspection_error = manifest_.on_inspection_error, .bundle_id = *id}));
  id_ = *std::move(id);
  return absl::OkStatus();
}

// What the manifest lists and no rule names.
std::vector<std::string> Reading::Unused() const {
  const std::vector<lang::Inspection>& used = program_->rules().inspections;
  const auto is_used = [&](lang::Inspection::Kind kind, const std::string lang::Inspection::*field,
                           const std::string& value) {
    return std::any_of(used.begin(), used.end(), [&](const lang::Inspection& inspection) {
      return inspection.kind == kind && inspection.*field == value;
    });
  };
  std::vector<std::string> out;
  using Kind = lang::Inspection::Kind;
  for (const std::string& path : manifest_.yara) {
    if (is_used(Kind::kPayload, &lang::Inspection::path, absl::StrCat(prefix_, path))) continue;
    out.push_back(absl::StrCat("YARA file `", path, "` is listed, and no rule names it"));
  }
  for (const ManifestPlugin& plugin : manifest_.plugins) {
    if (is_used(Kind::kPlugin, &lang::Inspection::name, plugin.id)) continue;
    out.push_back(absl::StrCat("plugin `", plugin.id, "` is listed, and no rule names it"));
  }
  return out;
}

// Last component of the directory's path; empty if there is none.
std::string DirectoryName(const std::string& dir) {
  std::error_code error;
  std::filesystem::path path = std::filesystem::absolute(dir, error);
  if (error) return "";
  path = (path / "").lexically_normal();
  return path.parent_path().filename().string();
}

}  // namespace

absl::StatusOr<Bundle> LoadBundle(const std::string& dir, const Clock* clock,
                                  const inspect::InspectOptions& options) {
  Reading reading(dir);
  std::vector<lang::Diagnostic> wrong = reading.diagnostics();
  std::erase_if(wrong, [](const lang::Diagnostic& each) {
    return lang::SeverityOf(each.kind) == lang::DiagnosticSeverity::kNote;
  });
  std::string places = lang::RenderPlaces(reading.files(), wrong);
  if (!reading.problems().empty()) return reading.problems().front();
  if (!reading.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat(places, "`ripsctl rules check ", dir, "` shows them"));
  }
  Bundle bundle;
  bundle.id = reading.id();
  bundle.manifest = reading.manifest();
  bundle.program = reading.program();
  bundle.warnings = std::move(places);
  bundle.start_level = *bundle.levels().Find(bundle.manifest.start_level);
  const std::vector<lang::Inspection>& inspections = bundle.program->rules().inspections;
  if (!inspections.empty()) {
    RIPS_ASSIGN_OR_RETURN(bundle.inspections,
                          inspect::LoadInspections(inspections, reading.checked(), options, clock));
  }
  return bundle;
}

absl::StatusOr<std::string> BundleIdOf(const std::string& dir) {
  std::string manifest_text;
  absl::btree_map<std::string, std::string> hashes;
  RIPS_RETURN_IF_ERROR(ReadContents(dir, [&](const ContentFile& file, std::string bytes) {
    hashes[file.path] = Sha256Hex(bytes);
    if (file.path == kManifestName) manifest_text = std::move(bytes);
    return absl::OkStatus();
  }));
  RIPS_ASSIGN_OR_RETURN(const Manifest manifest, ParseManifest(kManifestName, manifest_text));
  return IdOf(manifest, [&](const std::string& path) { return hashes[path]; });
}

BundleCheck CheckBundle(const std::string& dir) {
  const Reading reading(dir);
  BundleCheck check;
  check.name = reading.manifest().name;
  check.files = reading.files();
  check.diagnostics = reading.diagnostics();
  for (const absl::Status& problem : reading.problems()) {
    check.problems.push_back(std::string(problem.message()));
  }
  if (!reading.ok()) return check;
  check.id = reading.id();
  check.rules = reading.program()->rules().rules.size();
  check.levels = static_cast<size_t>(reading.program()->rules().levels.size());
  if (const std::string found = DirectoryName(dir); found != check.name) {
    check.warnings.push_back(absl::StrCat("the manifest calls it `", check.name,
                                          "`, its directory is `", found,
                                          "`; the server looks for it in a directory of its name"));
  }
  for (std::string& unused : reading.Unused()) check.warnings.push_back(std::move(unused));
  return check;
}

}  // namespace rips::bundle
