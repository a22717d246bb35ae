#include "policy_server/policy/bundle/manifest.h"

#include <algorithm>
#include <utility>

#include "absl/container/btree_set.h"
#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "policy_server/policy/bundle/bundle_signature.h"
#include "policy_server/policy/lang/limits.h"
#include "re2/re2.h"
#include "services/base/payload_limits.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_reader.h"
#include "services/runtime/config_sections.h"

namespace rips::bundle {
namespace {

void CheckCount(const ConfigSection& section, absl::string_view key, size_t count,
                absl::string_view what, size_t max) {
  if (count > max) section.Problem(key, absl::StrCat(count, " ", what, " exceed limit ", max));
}

void CheckPath(const ConfigSection& section, absl::string_view key, absl::string_view path) {
  const absl::Status status = CheckBundlePath(path);
  if (!status.ok()) section.Problem(key, status.message());
  const absl::string_view first = path.substr(0, path.find('/'));
  if (first == kSignatureName || first == kSignatureTemporaryName) {
    section.Problem(key, absl::StrCat("`", first, "` is where the bundle's signature is written; ",
                                      "give the file another name"));
  }
}

// `kind` is "rule file" or "YARA file".
void CheckPaths(const ConfigSection& root, absl::string_view key, absl::string_view kind,
                const std::vector<std::string>& paths, size_t max) {
  CheckCount(root, key, paths.size(), absl::StrCat(kind, "s"), max);
  absl::btree_set<absl::string_view> seen;
  for (const std::string& path : paths) {
    CheckPath(root, key, path);
    if (!seen.insert(path).second) {
      root.Problem(key, absl::StrCat(kind, " `", path, "` is listed twice"));
    }
  }
}

void ReadLevels(const ConfigSection& root, Manifest* manifest) {
  root.Required("levels", &manifest->levels);
  CheckCount(root, "levels", manifest->levels.size(), "levels", lang::kLevelsMax);
  if (!manifest->levels.empty()) manifest->start_level = manifest->levels.front();
  root.Optional("start_level", &manifest->start_level);
  const auto& levels = manifest->levels;
  if (!levels.empty() &&
      std::find(levels.begin(), levels.end(), manifest->start_level) == levels.end()) {
    root.Problem("start_level",
                 absl::StrCat("start level `", manifest->start_level, "` is not one of `levels`"));
  }
}

void ReadTwoPerson(const ConfigSection& root, Manifest* manifest) {
  root.Optional("two_person", &manifest->two_person);
  const std::vector<std::string>& levels = manifest->levels;
  absl::btree_set<absl::string_view> seen;
  for (const std::string& level : manifest->two_person) {
    const auto found = std::find(levels.begin(), levels.end(), level);
    if (found == levels.end()) {
      root.Problem("two_person", absl::StrCat("`", level, "` is not one of `levels`"));
    } else if (found == levels.begin()) {
      root.Problem("two_person", absl::StrCat("no level is below `", level, "`"));
    }
    if (!seen.insert(level).second) {
      root.Problem("two_person", absl::StrCat("`", level, "` is listed twice"));
    }
  }
}

// Why sensors would not take the pattern; empty if they do. Its size is added to `instructions`.
std::string PatternProblem(const std::string& pattern, size_t* instructions) {
  // As sensors compile it first (kInterestPatternBytes).
  constexpr int64_t kPatternBytes = int64_t{64} << 10;
  // Of all limits together; sensors take 200,000 of these and the rules' patterns.
  constexpr size_t kInstructionsMax = 50'000;
  RE2::Options options;
  options.set_log_errors(false);
  options.set_max_mem(kPatternBytes);
  const RE2 regex(pattern, options);
  if (!regex.ok()) return absl::StrCat("bad pattern: ", regex.error());
  *instructions += static_cast<size_t>(regex.ProgramSize());
  if (*instructions <= kInstructionsMax) return "";
  return absl::StrCat("with it, the patterns exceed the limit of ", kInstructionsMax,
                      " instructions");
}

void ReadPayloadLimits(const ConfigSection& root, engine::PayloadLimits* limits) {
  const std::vector<ConfigSection> sections = root.Sections("payload_limits");
  CheckCount(root, "payload_limits", sections.size(), "payload limits", kPayloadLimitsMax);
  absl::btree_set<std::string> seen;
  size_t instructions = 0;
  for (const ConfigSection& section : sections) {
    engine::PayloadLimit limit;
    ByteSize bytes;
    section.Required("topics", &limit.topic_regex);
    section.Required("bytes", &bytes,
                     ConfigRange<ByteSize>{{kPayloadBytesLeast}, {kPayloadBytesHard}});
    limit.bytes = static_cast<uint32_t>(bytes.bytes);
    if (const std::string problem = PatternProblem(limit.topic_regex, &instructions);
        !problem.empty()) {
      section.Problem("topics", problem);
    }
    if (!seen.insert(limit.topic_regex).second) {
      section.Problem("topics", absl::StrCat("`", limit.topic_regex, "` is listed twice"));
    }
    limits->push_back(std::move(limit));
  }
}

bool IsSha256(absl::string_view text) {
  return text.size() == 64 && std::all_of(text.begin(), text.end(), [](char c) {
           return absl::ascii_isdigit(c) || (c >= 'a' && c <= 'f');
         });
}

void ReadPlugins(const ConfigSection& root, std::vector<ManifestPlugin>* plugins) {
  const std::vector<ConfigSection> sections = root.Sections("plugins");
  CheckCount(root, "plugins", sections.size(), "plugins", kInspectionFilesMax);
  absl::btree_set<std::string> seen;
  for (const ConfigSection& section : sections) {
    ManifestPlugin plugin;
    section.Required("id", &plugin.id);
    section.Required("path", &plugin.path);
    section.Required("sha256", &plugin.sha256);
    CheckPath(section, "path", plugin.path);
    if (!IsSha256(plugin.sha256)) {
      section.Problem("sha256", "it is 64 lower-case hexadecimal digits, as sha256sum prints");
    }
    if (!seen.insert(plugin.id).second) {
      section.Problem("id", absl::StrCat("plugin `", plugin.id, "` is listed twice"));
    }
    plugins->push_back(std::move(plugin));
  }
}

void RefuseIf(bool used, const ConfigSection& section, absl::string_view key,
              absl::string_view remedy) {
  if (!used) return;
  section.Problem(key, absl::StrCat("`", key, "` is not available in this version; ", remedy));
}

void ReadUnavailable(const ConfigSection& root) {
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
  root.Required("rules", &manifest.rules);
  CheckPaths(root, "rules", "rule file", manifest.rules, kRuleFilesMax);
  ReadLevels(root, &manifest);
  ReadTwoPerson(root, &manifest);
  using Dialect = lang::CheckedRules::Dialect;
  root.OptionalEnum<Dialect>("dialect", &manifest.dialect,
                             {{"rips", Dialect::kRips}, {"prototype", Dialect::kPrototype}});
  root.Optional("soft_hold", &manifest.soft_hold, {absl::Milliseconds(500), absl::Hours(1)});
  using OnError = engine::OnInspectionError;
  root.OptionalEnum<OnError>(
      "on_inspection_error", &manifest.on_inspection_error,
      {{"match", OnError::kMatch}, {"alert", OnError::kAlert}, {"ignore", OnError::kIgnore}});
  root.Optional("yara", &manifest.yara);
  CheckPaths(root, "yara", "YARA file", manifest.yara, kInspectionFilesMax);
  ReadPlugins(root, &manifest.plugins);
  ReadPayloadLimits(root, &manifest.payload_limits);
  ReadUnavailable(root);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return manifest;
}

}  // namespace rips::bundle
