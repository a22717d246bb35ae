#include "policy_server/ripsctl/cli/settings.h"

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_reader.h"

namespace rips::ripsctl {
namespace {

struct Setting {
  const char* name;
  std::string RawSettings::*member;
  const char* fallback;
};

constexpr Setting kSettings[] = {
    {"server", &RawSettings::server, "127.0.0.1:7443"},
    {"cert", &RawSettings::cert, ""},
    {"key", &RawSettings::key, ""},
    {"ca", &RawSettings::ca, ""},
    {"output", &RawSettings::output, "text"},
    {"timeout", &RawSettings::timeout, "10s"},
};

}  // namespace

std::string SettingsPath(const GetEnv& get_env) {
  const std::optional<std::string> home = get_env("HOME");
  if (!home.has_value() || home->empty()) return "";
  return absl::StrCat(*home, "/.config/rips/ripsctl.yaml");
}

absl::StatusOr<RawSettings> ParseSettings(absl::string_view file, absl::string_view text) {
  ConfigReader reader(file, text);
  const ConfigSection root = reader.root();
  RawSettings settings;
  for (const Setting& setting : kSettings) {
    root.Optional(setting.name, &(settings.*setting.member));
  }
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return settings;
}

RawSettings Merge(RawSettings flags, const GetEnv& get_env, const RawSettings& file) {
  for (const Setting& setting : kSettings) {
    std::string& value = flags.*setting.member;
    if (value.empty()) {
      value = get_env(absl::StrCat("RIPSCTL_", absl::AsciiStrToUpper(setting.name))).value_or("");
    }
    if (value.empty()) value = file.*setting.member;
    if (value.empty()) value = setting.fallback;
  }
  return flags;
}

}  // namespace rips::ripsctl
