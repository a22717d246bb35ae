#include "policy_server/ripsctl/cli/settings.h"

#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_reader.h"
#include "services/text/nearest.h"

namespace rips::ripsctl {
namespace {

struct Setting {
  const char* name;
  std::string RawSettings::*member;
  const char* fallback;
  bool is_path = false;
};

constexpr Setting kSettings[] = {
    {"server", &RawSettings::server, "127.0.0.1:7443"},
    {"cert", &RawSettings::cert, "", true},
    {"key", &RawSettings::key, "", true},
    {"ca", &RawSettings::ca, "", true},
    {"output", &RawSettings::output, "text"},
    {"timeout", &RawSettings::timeout, "10s"},
};
constexpr absl::string_view kContextVariable = "RIPSCTL_CONTEXT";
constexpr absl::string_view kCurrentKey = "current:";

std::string VariableOf(const Setting& setting) {
  return absl::StrCat(kSettingVariablePrefix, absl::AsciiStrToUpper(setting.name));
}

// With the slash; empty for a file in the working directory.
absl::string_view DirectoryOf(absl::string_view file) {
  const size_t slash = file.rfind('/');
  return slash == absl::string_view::npos ? "" : file.substr(0, slash + 1);
}

RawSettings ReadSection(const ConfigSection& section, absl::string_view directory,
                        bool needs_server) {
  RawSettings settings;
  for (const Setting& setting : kSettings) {
    std::string& value = settings.*setting.member;
    if (needs_server && setting.member == &RawSettings::server) {
      section.Required(setting.name, &value);
    } else {
      section.Optional(setting.name, &value);
    }
    if (setting.is_path && !value.empty() && value[0] != '/') {
      value = absl::StrCat(directory, value);
    }
  }
  return settings;
}

// How a name is written so that YAML reads it as this text.
std::string YamlName(absl::string_view name) {
  return absl::EqualsIgnoreCase(name, "null") ? absl::StrCat("\"", name, "\"") : std::string(name);
}

// `line`, which begins with the key, with another value. What follows the old one, as a comment,
// stays.
std::string WithName(absl::string_view line, absl::string_view name) {
  const auto is_name = [](char c) { return absl::ascii_isalnum(c) || c == '-'; };
  const auto is_quote = [](char c) { return c == '"' || c == '\''; };
  size_t from = kCurrentKey.size();
  while (from < line.size() && absl::ascii_isspace(line[from])) ++from;
  size_t to = from;
  while (to < line.size() && (is_name(line[to]) || is_quote(line[to]))) ++to;
  return absl::StrCat(line.substr(0, from), YamlName(name), line.substr(to));
}

// Lines keep their `\r`. The line of the key `current`, else a new one above the first key.
std::string ReplaceOrInsert(absl::string_view text, absl::string_view name) {
  std::vector<std::string> lines = absl::StrSplit(text, '\n');
  const auto old = std::find_if(lines.begin(), lines.end(), [](const std::string& line) {
    return absl::StartsWith(line, kCurrentKey);
  });
  if (old != lines.end()) {
    *old = WithName(*old, name);
    return absl::StrJoin(lines, "\n");
  }
  const auto first_key = std::find_if(lines.begin(), lines.end(), [](const std::string& line) {
    const absl::string_view bare = absl::StripAsciiWhitespace(line);
    return !bare.empty() && bare[0] != '#' && bare[0] != '%' && !absl::StartsWith(bare, "---");
  });
  const bool with_return = absl::StrContains(text, "\r\n");
  lines.insert(first_key, absl::StrCat(kCurrentKey, " ", YamlName(name), with_return ? "\r" : ""));
  return absl::StrJoin(lines, "\n");
}

bool Same(const RawSettings& a, const RawSettings& b) {
  return std::all_of(std::begin(kSettings), std::end(kSettings), [&](const Setting& setting) {
    return a.*setting.member == b.*setting.member;
  });
}

// But for `current`.
bool Same(const SettingsFile& a, const SettingsFile& b) {
  return Same(a.top, b.top) && std::equal(a.contexts.begin(), a.contexts.end(), b.contexts.begin(),
                                          b.contexts.end(), [](const auto& x, const auto& y) {
                                            return x.first == y.first && Same(x.second, y.second);
                                          });
}

}  // namespace

std::string SettingsPath(const GetEnv& get_env) {
  const std::optional<std::string> home = get_env("HOME");
  if (!home.has_value() || home->empty()) return "";
  return absl::StrCat(*home, "/.config/rips/ripsctl.yaml");
}

absl::StatusOr<SettingsFile> ParseSettings(absl::string_view file, absl::string_view text) {
  ConfigReader reader(file, text);
  const ConfigSection root = reader.root();
  const absl::string_view directory = DirectoryOf(file);
  SettingsFile settings;
  settings.top = ReadSection(root, directory, /*needs_server=*/false);
  root.Optional("current", &settings.current);
  const ConfigSection contexts = root.OptionalSection("contexts");
  for (const std::string& name : contexts.Keys()) {
    if (!IsValidName(name)) {
      contexts.Problem(name, ValidateName("name of a context", name).message());
    }
    settings.contexts[name] =
        ReadSection(contexts.RequiredSection(name), directory, /*needs_server=*/true);
  }
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return settings;
}

absl::Status CheckContext(absl::string_view name, absl::string_view origin,
                          const SettingsFile& file) {
  if (file.contexts.contains(std::string(name))) return absl::OkStatus();
  std::vector<absl::string_view> known;
  for (const auto& [each, settings] : file.contexts) known.push_back(each);
  if (known.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(origin, " is `", name,
                     "`, but the settings file has no contexts; see `ripsctl context --help`"));
  }
  const std::string hint = NearestHint(name, known);
  return absl::InvalidArgumentError(
      absl::StrCat(origin, " is `", name, "`, which is no context of the settings file; ", hint,
                   hint.empty() ? "it has " : " It has ", absl::StrJoin(known, ", ")));
}

absl::StatusOr<std::string> ChooseContext(const RawSettings& flags, const GetEnv& get_env,
                                          const SettingsFile& file) {
  std::string name = flags.context;
  absl::string_view origin = "--context";
  if (name.empty()) {
    name = get_env(std::string(kContextVariable)).value_or("");
    origin = kContextVariable;
  }
  if (name.empty()) {
    name = file.current;
    origin = "`current` of the settings file";
  }
  if (!name.empty()) RIPS_RETURN_IF_ERROR(CheckContext(name, origin, file));
  return name;
}

RawSettings Merge(RawSettings flags, const GetEnv& get_env, const SettingsFile& file) {
  const auto context = file.contexts.find(flags.context);
  for (const Setting& setting : kSettings) {
    std::string& value = flags.*setting.member;
    if (value.empty()) value = get_env(VariableOf(setting)).value_or("");
    if (value.empty() && context != file.contexts.end()) value = context->second.*setting.member;
    if (value.empty()) value = file.top.*setting.member;
    if (value.empty()) value = setting.fallback;
  }
  return flags;
}

absl::StatusOr<std::string> WithCurrentContext(absl::string_view file, absl::string_view text,
                                               absl::string_view name) {
  RIPS_ASSIGN_OR_RETURN(const SettingsFile before, ParseSettings(file, text));
  std::string changed = ReplaceOrInsert(text, name);
  const absl::StatusOr<SettingsFile> after = ParseSettings(file, changed);
  // The text may be YAML that is laid out in another way: nothing is written that means other than
  // it should.
  if (!after.ok() || after->current != name || !Same(before, *after)) {
    return absl::FailedPreconditionError(
        absl::StrCat("cannot change `current` in ", file, "; write `current: ", YamlName(name),
                     "` on a line of its own, without indentation"));
  }
  return changed;
}

std::vector<std::string> SettingVariables() {
  std::vector<std::string> names;
  for (const Setting& setting : kSettings) names.push_back(VariableOf(setting));
  names.emplace_back(kContextVariable);
  return names;
}

}  // namespace rips::ripsctl
