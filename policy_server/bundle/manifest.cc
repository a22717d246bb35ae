#include "policy_server/bundle/manifest.h"

#include <algorithm>

#include "absl/container/btree_set.h"
#include "absl/strings/str_cat.h"
#include "policy_server/bundle/bundle_files.h"
#include "policy_server/lang/limits.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_reader.h"
#include "services/runtime/config_sections.h"

namespace rips::bundle {
namespace {

void ReadRules(const ConfigSection& root, std::vector<std::string>* rules) {
  root.Required("rules", rules);
  if (rules->size() > kRuleFilesMax) {
    root.Problem("rules", absl::StrCat(rules->size(), " rule files exceed limit ", kRuleFilesMax));
  }
  absl::btree_set<absl::string_view> seen;
  for (const std::string& path : *rules) {
    if (const absl::Status status = CheckBundlePath(path); !status.ok()) {
      root.Problem("rules", status.message());
    }
    if (!seen.insert(path).second) {
      root.Problem("rules", absl::StrCat("rule file `", path, "` is listed twice"));
    }
  }
}

void ReadLevels(const ConfigSection& root, Manifest* manifest) {
  root.Required("levels", &manifest->levels);
  if (manifest->levels.size() > lang::kLevelsMax) {
    root.Problem("levels",
                 absl::StrCat(manifest->levels.size(), " levels exceed limit ", lang::kLevelsMax));
  }
  if (!manifest->levels.empty()) manifest->start_level = manifest->levels.front();
  root.Optional("start_level", &manifest->start_level);
  const auto& levels = manifest->levels;
  if (!levels.empty() &&
      std::find(levels.begin(), levels.end(), manifest->start_level) == levels.end()) {
    root.Problem("start_level",
                 absl::StrCat("start level `", manifest->start_level, "` is not one of `levels`"));
  }
}

void RefuseIf(bool used, const ConfigSection& section, absl::string_view key,
              absl::string_view remedy) {
  if (!used) return;
  section.Problem(key, absl::StrCat("`", key, "` is not available in this version; ", remedy));
}

void ReadUnavailable(const ConfigSection& root) {
  std::vector<std::string> yara;
  root.Optional("yara", &yara);
  RefuseIf(!yara.empty(), root, "yara", "remove it, and the rules that look into payloads");

  const std::vector<ConfigSection> plugins = root.Sections("plugins");
  for (const ConfigSection& plugin : plugins) {
    std::string ignored;
    for (const char* key : {"id", "path", "sha256"}) plugin.Required(key, &ignored);
  }
  RefuseIf(!plugins.empty(), root, "plugins", "remove it, and the rules that use plugins");

  std::vector<std::string> two_person;
  root.Optional("two_person", &two_person);
  RefuseIf(!two_person.empty(), root, "two_person", "remove it; one operator may lower a level");

  const ConfigSection scope = root.OptionalSection("scope");
  for (const char* key : {"namespaces", "hosts"}) {
    std::vector<std::string> names;
    scope.Optional(key, &names);
    RefuseIf(!names.empty(), scope, key, "leave it empty; all that is seen is judged");
  }
}

}  // namespace

absl::StatusOr<Manifest> ParseManifest(absl::string_view file, absl::string_view text) {
  ConfigReader reader(file, text);
  const ConfigSection root = reader.root();
  Manifest manifest;
  ReadName(root, "name", "bundle name", &manifest.name);
  ReadRules(root, &manifest.rules);
  ReadLevels(root, &manifest);
  using Dialect = lang::CheckedRules::Dialect;
  root.OptionalEnum<Dialect>("dialect", &manifest.dialect,
                             {{"rips", Dialect::kRips}, {"prototype", Dialect::kPrototype}});
  root.Optional("soft_hold", &manifest.soft_hold, {absl::Milliseconds(500), absl::Hours(1)});
  using OnError = Manifest::OnInspectionError;
  root.OptionalEnum<OnError>(
      "on_inspection_error", &manifest.on_inspection_error,
      {{"match", OnError::kMatch}, {"alert", OnError::kAlert}, {"ignore", OnError::kIgnore}});
  ReadUnavailable(root);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return manifest;
}

}  // namespace rips::bundle
