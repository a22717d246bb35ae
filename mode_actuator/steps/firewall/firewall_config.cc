#include "mode_actuator/steps/firewall/firewall_config.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <set>
#include <variant>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "mode_actuator/steps/firewall/real_host.h"
#include "mode_actuator/steps/firewall/target.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {
namespace {

using Kind = FirewallStep::Kind;

constexpr const char* kForms[] = {"file", "isolate_host", "isolate_participant", "release"};

void ReadTargets(const ConfigSection& body, const std::string& key,
                 const std::vector<std::string>& servers, FirewallStep* step) {
  std::vector<std::string> texts;
  body.Required(key, &texts);
  if (texts.size() > kTargetsMax) {
    body.Problem(key, absl::StrCat(texts.size(), " targets exceed limit ", kTargetsMax));
    return;
  }
  KeptOpen kept;
  for (const std::string& server : servers) {
    const absl::StatusOr<ControlAddress> numeric = ParseNumericServer(server);
    if (numeric.ok()) kept.servers.push_back(numeric->address);
  }
  for (const std::string& text : texts) {
    const absl::StatusOr<Target> target =
        step->kind == Kind::kIsolateHosts ? ParseHostTarget(text) : ParseParticipantTarget(text);
    absl::Status status = target.status();
    if (status.ok()) status = CheckMayBeIsolated(*target, kept);
    if (!status.ok()) {
      body.Problem(key, status.message());
      continue;
    }
    if (std::find(step->targets.begin(), step->targets.end(), target->text) ==
        step->targets.end()) {
      step->targets.push_back(target->text);
    }
  }
}

}  // namespace

FirewallSettings ReadFirewall(const ConfigSection& root) {
  FirewallSettings settings;
  const ConfigSection section = root.OptionalSection("firewall");
  if (section.Has("socket")) ReadPath(section, "socket", &settings.socket);
  section.Optional("user", &settings.user);
  section.Optional("run_as", &settings.run_as);
  section.Optional("hold", &settings.hold, {kFirewallHoldMin, kFirewallHoldMax});
  return settings;
}

FirewallStep ReadFirewallStep(const ConfigSection& body, const FirewallSettings& settings,
                              const std::vector<std::string>& servers) {
  FirewallStep step;
  const auto forms = std::count_if(std::begin(kForms), std::end(kForms),
                                   [&](const char* form) { return body.Has(form); });
  if (forms != 1) {
    body.Problem("",
                 "a firewall step needs exactly one of `file`, `isolate_host`, "
                 "`isolate_participant` and `release`");
    std::string unused;
    for (const char* form : kForms) body.Optional(form, &unused);
  } else if (body.Has("file")) {
    step.kind = Kind::kRules;
    ReadPath(body, "file", &step.file);
  } else if (body.Has("isolate_host")) {
    step.kind = Kind::kIsolateHosts;
    ReadTargets(body, "isolate_host", servers, &step);
  } else if (body.Has("isolate_participant")) {
    step.kind = Kind::kIsolateParticipants;
    ReadTargets(body, "isolate_participant", servers, &step);
  } else {
    step.kind = Kind::kRelease;
    std::string what;
    body.Required("release", &what);
    if (what != "all") body.Problem("release", "write `release: all`");
    if (body.Has("for")) body.Problem("for", "a release has no time limit");
  }
  // Who is released by the clock must not come back earlier than one who is released by a step.
  body.Optional("for", &step.hold_for, {settings.hold, kFirewallForMax});
  return step;
}

void CheckFirewallSteps(const ConfigSection& level, const std::string& key,
                        const std::vector<Step>& steps) {
  int files = 0;
  bool releases = false;
  bool holds = false;
  for (const Step& step : steps) {
    const auto* firewall = std::get_if<FirewallStep>(&step.what);
    if (firewall == nullptr) continue;
    files += firewall->kind == Kind::kRules ? 1 : 0;
    releases = releases || firewall->kind == Kind::kRelease;
    // Entered again by a retry or after a drift, the release would undo the steps after it.
    holds = holds || firewall->kind != Kind::kRelease;
  }
  if (files > 1) {
    level.Problem(key, "has two firewall files; the second would take the place of the first");
  }
  if (releases && holds) {
    level.Problem(key, "has a firewall release beside other firewall steps; release in `leave`");
  }
}

bool HasFirewallSteps(const std::vector<LevelSpec>& levels) {
  bool has = false;
  ForEachStep(levels, [&](const Step& step) {
    has = has || std::holds_alternative<FirewallStep>(step.what);
  });
  return has;
}

std::vector<std::string> FirewallWarnings(const std::vector<LevelSpec>& levels) {
  const auto has = [](const std::vector<Step>& steps, bool release) {
    return std::any_of(steps.begin(), steps.end(), [release](const Step& step) {
      const auto* firewall = std::get_if<FirewallStep>(&step.what);
      return firewall != nullptr && (firewall->kind == FirewallStep::Kind::kRelease) == release;
    });
  };
  std::vector<std::string> warnings;
  if (levels.empty() || has(levels.front().enter, /*release=*/true)) return warnings;
  const std::string& lowest = levels.front().name;
  for (const LevelSpec& level : levels) {
    if (&level == &levels.front() || !has(level.enter, /*release=*/false) ||
        has(level.leave, /*release=*/true)) {
      continue;
    }
    warnings.push_back(absl::StrCat(
        "what level `", level.name, "` puts into the firewall stays in force at `", lowest,
        "` until its time (`for`) is over; write `{firewall: {release: all}}` in the `enter` of `",
        lowest, "`"));
  }
  return warnings;
}

std::vector<std::string> FirewallFiles(const std::vector<LevelSpec>& levels) {
  std::set<std::string> files;
  ForEachStep(levels, [&](const Step& step) {
    const auto* firewall = std::get_if<FirewallStep>(&step.what);
    if (firewall != nullptr && !firewall->file.empty()) files.insert(firewall->file);
  });
  return {files.begin(), files.end()};
}

absl::Status CheckFirewallFiles(const std::vector<LevelSpec>& levels,
                                const std::vector<ConfigSetting>& settings) {
  for (const std::string& file : FirewallFiles(levels)) {
    const absl::Status wrong = ReadFragment(file).status();
    if (wrong.ok()) continue;
    const auto names_it = [&](const ConfigSetting& each) {
      return absl::EndsWith(each.path, ".firewall.file") &&
             each.value == absl::StrCat("\"", file, "\"");
    };
    const auto setting = std::find_if(settings.begin(), settings.end(), names_it);
    if (setting == settings.end()) return wrong;
    return absl::Status(wrong.code(), absl::StrCat(setting->source, ": ", wrong.message()));
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<FragmentRule>> ReadFragment(const std::string& path) {
  const auto unsafe = [&](absl::string_view why) {
    return absl::PermissionDeniedError(absl::StrCat("`", path, "` ", why));
  };
  // Not blocking: a FIFO without a writer must not stop us.
  const UniqueFd file(open(path.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC | O_NONBLOCK));
  if (file.get() < 0) {
    if (errno == ELOOP) return unsafe("is a symbolic link; name its target");
    const std::string why = absl::StrCat("cannot read `", path, "`: ", std::strerror(errno));
    return errno == ENOENT ? absl::NotFoundError(why) : absl::UnavailableError(why);
  }
  struct stat info;
  if (fstat(file.get(), &info) != 0 || !S_ISREG(info.st_mode)) {
    return unsafe("is no regular file");
  }
  if (info.st_uid != 0 && info.st_uid != geteuid()) return unsafe("is not owned by root");
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) != 0) {
    return unsafe("can be written by others; chmod go-w");
  }
  std::string text;
  char buffer[16 << 10];
  while (text.size() <= kFragmentBytesMax) {
    const ssize_t got = read(file.get(), buffer, sizeof(buffer));
    if (got == 0) break;
    if (got > 0) {
      text.append(buffer, static_cast<size_t>(got));
    } else if (errno != EINTR) {
      return absl::UnavailableError(
          absl::StrCat("cannot read `", path, "`: ", std::strerror(errno)));
    }
  }
  return ParseFragment(path, text);
}

}  // namespace rips::actuator
