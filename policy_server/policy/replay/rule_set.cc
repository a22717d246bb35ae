#include "policy_server/policy/replay/rule_set.h"

#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/inspect/checked_files.h"
#include "policy_server/policy/inspect/file_source.h"
#include "policy_server/policy/lang/limits.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"

namespace rips::replay {
namespace {

absl::StatusOr<RuleSet> LoadFromBundle(const std::string& dir, const Clock* clock) {
  RIPS_ASSIGN_OR_RETURN(bundle::Bundle of, bundle::LoadBundle(dir, clock));
  return RuleSet{.program = std::move(of.program),
                 .inspections = std::move(of.inspections),
                 .bundle_id = std::move(of.id),
                 .start_level = of.start_level,
                 .soft_hold_ns = absl::ToInt64Nanoseconds(of.manifest.soft_hold),
                 .two_person = std::move(of.manifest.two_person)};
}

}  // namespace

absl::StatusOr<RuleSet> LoadRuleSet(const std::vector<std::string>& paths,
                                    const RuleSetOptions& options, const Clock* clock) {
  std::error_code error;
  if (paths.size() == 1 && std::filesystem::is_directory(paths[0], error)) {
    return LoadFromBundle(paths[0], clock);
  }
  RuleSet set;
  for (const std::string& path : paths) {
    if (std::filesystem::is_directory(path, error)) {
      return absl::InvalidArgumentError(
          absl::StrCat("`", path, "` is a directory; a bundle must be the only entry"));
    }
    RIPS_ASSIGN_OR_RETURN(std::string text, ReadFile(path, lang::kFileBytesMax));
    set.files.push_back({.path = path, .text = std::move(text)});
  }
  const inspect::DiskFiles disk;
  inspect::CheckedFiles checked(&disk);
  lang::CompileResult compiled =
      lang::Compile(set.files, {.dialect = options.dialect, .inspection_files = &checked});
  set.diagnostics = std::move(compiled.diagnostics);
  if (!compiled.rules.has_value()) return set;
  if (!compiled.rules->inspections.empty()) {
    RIPS_ASSIGN_OR_RETURN(
        set.inspections, inspect::LoadInspections(compiled.rules->inspections, checked, {}, clock));
  }
  RIPS_ASSIGN_OR_RETURN(set.program, engine::CompiledPolicy::Create(
                                         *std::move(compiled.rules),
                                         {.on_inspection_error = options.on_inspection_error}));
  return set;
}

}  // namespace rips::replay
