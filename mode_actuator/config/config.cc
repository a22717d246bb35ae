#include "mode_actuator/config/config.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>
#include <variant>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "mode_actuator/steps/alarm/alarm_config.h"
#include "mode_actuator/steps/program/level_scripts.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/config_reader.h"
#include "services/runtime/log.h"
#include "services/text/quote.h"

namespace rips::actuator {
namespace {

constexpr absl::Duration kModeTimeout = absl::Seconds(3);
constexpr int kModeRetries = 2;

bool IsLevelName(absl::string_view name) {
  if (name.empty() || name.size() > kLevelNameBytesMax) return false;
  return std::all_of(name.begin(), name.end(),
                     [](char c) { return absl::ascii_isalnum(c) || c == '_'; });
}

void CheckArgs(const ConfigSection& section, const std::vector<std::string>& args) {
  size_t longest = 0;
  for (const std::string& arg : args) longest = std::max(longest, arg.size());
  if (args.size() > 64 || longest > 4096) {
    section.Problem("args", "at most 64 arguments of 4096 bytes");
  }
}

// One of `system_mode`, `program`, `alarm` and `firewall`; false if it is none of them.
bool ReadWhat(const ConfigSection& section, const Config& config, Step* step) {
  const bool is_mode = section.Has("system_mode");
  const bool is_alarm = section.Has("alarm");
  const bool is_firewall = section.Has("firewall");
  if (is_mode + is_alarm + is_firewall + section.Has("program") != 1) {
    section.Problem("",
                    "a step needs exactly one of `system_mode`, `program`, `alarm` and `firewall`");
    return false;
  }
  if (is_alarm) {
    step->timeout = kAlarmTimeout;
    step->retries = kAlarmRetries;
    step->what = ReadAlarmStep(section.RequiredSection("alarm"), config.devices);
    return true;
  }
  if (is_firewall) {
    step->timeout = kFirewallStepTimeout;
    step->retries = kFirewallStepRetries;
    step->what =
        ReadFirewallStep(section.RequiredSection("firewall"), config.firewall, config.servers);
    return true;
  }
  if (is_mode) {
    const ConfigSection body = section.RequiredSection("system_mode");
    SystemModeStep mode;
    body.Required("part", &mode.part);
    body.Required("mode", &mode.mode);
    if (!mode.part.empty() && mode.part.front() != '/') {
      body.Problem("part", absl::StrCat(QuoteBytes(mode.part), " is not absolute; write `/",
                                        absl::CHexEscape(mode.part), "`"));
    }
    step->what = std::move(mode);
    step->timeout = kModeTimeout;
    step->retries = kModeRetries;
    return true;
  }
  const ConfigSection body = section.RequiredSection("program");
  ProgramStep program;
  body.Required("name", &program.name);
  body.Optional("args", &program.args);
  CheckArgs(body, program.args);
  const ProgramSpec* spec = FindNamed(config.programs, program.name);
  step->timeout = absl::Seconds(10);
  if (spec != nullptr) {
    step->timeout = spec->timeout;
  } else if (!program.name.empty()) {
    body.Problem("name",
                 absl::StrCat("program ", QuoteBytes(program.name), " is not in `programs`"));
  }
  step->what = std::move(program);
  return true;
}

std::vector<Step> ReadSteps(const ConfigSection& level, absl::string_view key,
                            const Config& config) {
  const std::vector<ConfigSection> sections = level.Sections(key);
  if (sections.size() > kStepsMax) {
    level.Problem(key, absl::StrCat(sections.size(), " steps exceed limit ", kStepsMax));
  }
  std::vector<Step> steps;
  std::set<std::string> parts;
  std::set<std::string> alarms;
  for (const ConfigSection& section : sections) {
    Step step;
    const bool complete = ReadWhat(section, config, &step);
    section.Optional("timeout", &step.timeout, {absl::Milliseconds(10), kLevelBudget});
    section.Optional("retries", &step.retries, {0, 20});
    section.OptionalEnum<OnFailure>("on_failure", &step.on_failure,
                                    {{"fail", OnFailure::kFail},
                                     {"continue", OnFailure::kContinue},
                                     {"stop", OnFailure::kStop}});
    if (!complete) continue;
    const auto* mode = std::get_if<SystemModeStep>(&step.what);
    if (mode != nullptr && !parts.insert(mode->part).second) {
      section.Problem("system_mode", absl::StrCat("part ", QuoteBytes(mode->part),
                                                  " is ordered twice in one list"));
    }
    const auto* alarm = std::get_if<AlarmStep>(&step.what);
    if (alarm != nullptr && !alarms.insert(alarm->device).second) {
      section.Problem("alarm", absl::StrCat("device ", QuoteBytes(alarm->device),
                                            " is ordered twice in one list"));
    }
    steps.push_back(std::move(step));
  }
  CheckFirewallSteps(level, std::string(key), steps);
  return steps;
}

// What is wrong with how long the steps may take; mostly nothing.
std::string OverBudget(const std::vector<Step>& steps) {
  absl::Duration sum;
  for (const Step& step : steps) sum += step.timeout * (1 + step.retries);
  if (sum <= kLevelBudget) return "";
  return absl::StrCat("the steps may take ", absl::FormatDuration(sum),
                      " (timeout x (1 + retries), summed), limit ",
                      absl::FormatDuration(kLevelBudget));
}

void CheckBudget(const ConfigSection& level, absl::string_view key,
                 const std::vector<Step>& steps) {
  if (const std::string over = OverBudget(steps); !over.empty()) level.Problem(key, over);
}

void ReadPrograms(const ConfigSection& root, Config* config) {
  const std::vector<ConfigSection> sections = root.Sections("programs");
  if (sections.size() > kProgramsMax) {
    root.Problem("programs",
                 absl::StrCat(sections.size(), " programs exceed limit ", kProgramsMax));
  }
  std::set<std::string> names;
  for (const ConfigSection& section : sections) {
    ProgramSpec program;
    section.Required("name", &program.name);
    section.Required("path", &program.path);
    if (!program.path.empty() && program.path.front() != '/') {
      section.Problem("path", absl::StrCat(QuoteBytes(program.path), " is not absolute"));
    }
    section.Optional("timeout", &program.timeout, {absl::Milliseconds(10), absl::Minutes(10)});
    section.Optional("concurrency", &program.concurrency, {1, 16});
    ReadProgramGuards(section, &program);
    if (!program.name.empty() && !names.insert(program.name).second) {
      section.Problem("name",
                      absl::StrCat("program ", QuoteBytes(program.name), " is listed twice"));
    }
    config->programs.push_back(std::move(program));
  }
}

void ReadLevels(const ConfigSection& root, Config* config) {
  const std::vector<ConfigSection> sections = root.Sections("levels");
  if (sections.empty()) root.Problem("levels", "needs at least one level");
  if (sections.size() > kLevelsMax) {
    root.Problem("levels", absl::StrCat(sections.size(), " levels exceed limit ", kLevelsMax));
  }
  std::set<std::string> names;
  for (const ConfigSection& section : sections) {
    LevelSpec level;
    section.Required("name", &level.name);
    if (!level.name.empty() && !IsLevelName(level.name)) {
      section.Problem("name", absl::StrCat(QuoteBytes(level.name),
                                           " is no level name; use letters, digits and `_`"));
    } else if (!level.name.empty() && !names.insert(level.name).second) {
      section.Problem("name", absl::StrCat("level ", QuoteBytes(level.name), " is listed twice"));
    }
    level.enter = ReadSteps(section, "enter", *config);
    level.leave = ReadSteps(section, "leave", *config);
    level.on_drift = ReadSteps(section, "on_drift", *config);
    CheckBudget(section, "on_drift", level.on_drift);
    CheckBudget(section, "enter", level.enter);
    config->levels.push_back(std::move(level));
  }
}

void ReadFailSafe(const ConfigSection& root, Config* config) {
  const ConfigSection section = root.RequiredSection("fail_safe");
  section.Required("level", &config->fail_safe_level);
  section.Required("after", &config->fail_safe_after, {absl::ZeroDuration(), absl::Hours(1)});
  const std::string& level = config->fail_safe_level;
  if (level.empty() || level == "keep") return;
  if (FindNamed(config->levels, level) == nullptr) {
    section.Problem("level",
                    absl::StrCat(QuoteBytes(level), " is none of `levels`; or write `keep`"));
  }
}

void ReadModesOptions(const ConfigSection& section, ModesOptions* options) {
  section.OptionalEnum<Verify>("verify", &options->verify,
                               {{"parts", Verify::kParts}, {"manager", Verify::kManager}});
  section.OptionalEnum<Backend>("backend", &options->backend,
                                {{"manager", Backend::kManager}, {"direct", Backend::kDirect}});
  const bool parts = options->verify == Verify::kParts;
  options->fallback = parts ? Fallback::kDirect : Fallback::kNone;
  section.OptionalEnum<Fallback>("fallback", &options->fallback,
                                 {{"direct", Fallback::kDirect}, {"none", Fallback::kNone}});
  if (parts) return;
  if (options->backend == Backend::kDirect) {
    section.Problem("backend",
                    "orders to the nodes are read back from them; write `verify: parts`");
  }
  if (options->fallback == Fallback::kDirect) {
    section.Problem("fallback",
                    "orders to the nodes are read back from them; write `verify: parts`");
  }
}

void CheckTopics(const ConfigSection& section, const std::vector<std::string>& topics) {
  constexpr absl::string_view kKey = "published_while_inactive";
  if (topics.size() > model::kTopicsWhileInactiveMax) {
    section.Problem(
        kKey, absl::StrCat(topics.size(), " topics exceed limit ", model::kTopicsWhileInactiveMax));
  }
  for (const std::string& topic : topics) {
    const absl::Status valid = ros2::ValidateTopicName(topic);
    if (!valid.ok()) section.Problem(kKey, valid.message());
  }
}

void ReadSystemModes(const ConfigSection& root, Config* config) {
  const ConfigSection section = root.OptionalSection("system_modes");
  if (section.present()) {
    ReadPath(section, "smh", &config->smh_file);
    ReadModesOptions(section, &config->modes);
    section.Optional("published_while_inactive", &config->published_while_inactive);
    CheckTopics(section, config->published_while_inactive);
  } else if (!ModeTargets(config->levels).empty()) {
    root.Problem("levels", "has `system_mode` steps but there is no `system_modes` section");
  }
}

}  // namespace

absl::StatusOr<ParsedConfig> ParseConfig(absl::string_view file, absl::string_view text) {
  ConfigReader reader(file, text);
  const ConfigSection root = reader.root();
  ParsedConfig parsed;
  Config& config = parsed.config;
  ReadName(root, "robot", "robot id", &config.robot);
  ReadName(root, "host", "host id", &config.host);
  root.Required("servers", &config.servers);
  for (const std::string& server : config.servers) {
    if (!IsHostPort(server)) {
      root.Problem("servers", absl::StrCat(QuoteBytes(server), " is not HOST:PORT"));
    }
  }
  config.tls = ReadTls(root);
  config.dds = ReadDds(root);
  if (root.Has("state_dir")) ReadPath(root, "state_dir", &config.state_dir);
  config.devices = ReadAlarmDevices(root);
  ReadPrograms(root, &config);
  config.exec = ReadExec(root);
  if (root.Has("scripts")) ReadPath(root, "scripts", &config.scripts);
  config.firewall = ReadFirewall(root);
  ReadLevels(root, &config);
  ReadFailSafe(root, &config);
  ReadSystemModes(root, &config);
  const ConfigSection timing = root.OptionalSection("timing");
  timing.Optional("floor_hold", &config.floor_hold, {absl::ZeroDuration(), absl::Minutes(5)});
  timing.Optional("reconcile", &config.reconcile, {absl::Milliseconds(100), absl::Minutes(1)});
  root.Optional("metrics", &config.metrics);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  parsed.settings = reader.Settings();
  return parsed;
}

absl::Status AddScripts(ParsedConfig* parsed) {
  Config& config = parsed->config;
  if (config.scripts.empty()) return absl::OkStatus();
  RIPS_RETURN_IF_ERROR(
      AddLevelScripts(config.scripts, &config.levels, &config.programs, &parsed->settings));
  for (const LevelSpec& level : config.levels) {
    const std::string over = OverBudget(level.enter);
    if (over.empty()) continue;
    return absl::InvalidArgumentError(
        absl::StrCat("level ", QuoteBytes(level.name), " with its script: ", over));
  }
  return absl::OkStatus();
}

std::vector<std::pair<std::string, std::string>> ModeTargets(const std::vector<LevelSpec>& levels) {
  std::set<std::pair<std::string, std::string>> targets;
  ForEachStep(levels, [&](const Step& step) {
    const auto* mode = std::get_if<SystemModeStep>(&step.what);
    if (mode != nullptr) targets.emplace(mode->part, mode->mode);
  });
  return {targets.begin(), targets.end()};
}

std::vector<std::string> ProtectedParts(const std::vector<LevelSpec>& levels, const Smh& smh,
                                        Backend backend) {
  std::vector<std::string> parts;
  std::set<std::string> known;
  const auto add = [&](const std::string& part) {
    if (backend == Backend::kDirect && smh.systems.contains(part)) return;
    if (!ros2::ValidateNodeName(part).ok() || parts.size() >= kProtectedPartsMax) return;
    if (known.insert(part).second) parts.push_back(part);
  };
  for (const auto& [part, mode] : ModeTargets(levels)) add(part);
  for (const auto& [part, system] : smh.systems) add(part);
  for (const auto& [part, node] : smh.nodes) add(part);
  if (parts.size() == kProtectedPartsMax) {
    LogWarning("sensors monitor only the first parts", {{"parts", kProtectedPartsMax}});
  }
  return parts;
}

std::vector<model::InactiveParts> InactiveParts(const std::vector<LevelSpec>& levels,
                                                const Smh& smh,
                                                const std::vector<std::string>& parts) {
  const std::set<std::string> named(parts.begin(), parts.end());
  std::vector<model::InactiveParts> all;
  for (const LevelSpec& level : levels) {
    std::map<std::string, PartState> states;
    const auto take = [&](const std::vector<Step>& steps, bool only_active) {
      for (const Step& step : steps) {
        const auto* mode = std::get_if<SystemModeStep>(&step.what);
        if (mode == nullptr) continue;
        const auto expected = smh.Expected(mode->part, mode->mode);
        if (!expected.ok()) continue;
        for (const ExpectedPart& node : *expected) {
          if (only_active && node.state != PartState::kActive) continue;
          states[node.node] = node.state;
        }
      }
    };
    take(level.enter, false);
    take(level.on_drift, true);
    model::InactiveParts inactive{.level = level.name, .parts = {}};
    for (const auto& [node, state] : states) {
      if (state == PartState::kInactive && named.contains(node)) inactive.parts.push_back(node);
    }
    if (!states.empty()) all.push_back(std::move(inactive));
  }
  return all;
}

absl::Status CheckLevelsAgainstSmh(const Config& config, const Smh& smh) {
  std::vector<std::string> problems;
  for (const LevelSpec& level : config.levels) {
    for (const auto& [part, mode] : ModeTargets({level})) {
      const auto expected = smh.Expected(part, mode);
      if (expected.ok()) continue;
      problems.push_back(absl::StrCat("level ", QuoteBytes(level.name), ": ",
                                      expected.status().message(), " (", config.smh_file, ")"));
    }
  }
  if (problems.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrJoin(problems, "\n"));
}

namespace {

// `node` is active, and was so with the same parameters.
bool IsSame(const std::map<std::string, ParameterMap>& active, const ExpectedPart& node) {
  const auto was = active.find(node.node);
  return was != active.end() && was->second == node.parameters;
}

}  // namespace

std::vector<std::string> MonotonyWarnings(const Config& config, const Smh& smh) {
  std::vector<std::string> warnings;
  std::set<std::string> off_before;
  std::map<std::string, ParameterMap> in_first;
  const auto place = [&smh](const SystemModeStep& step) {
    const auto system = smh.systems.find(step.part);
    if (system == smh.systems.end()) return std::string();
    return absl::StrCat(system->second.places.at(step.mode), ": ");
  };
  for (const LevelSpec& level : config.levels) {
    const bool is_first = &level == &config.levels.front();
    const bool is_last = !is_first && &level == &config.levels.back();
    std::set<std::string> off;
    for (const Step& step : level.enter) {
      const auto* mode = std::get_if<SystemModeStep>(&step.what);
      if (mode == nullptr) continue;
      const auto expected = smh.Expected(mode->part, mode->mode);
      if (!expected.ok()) continue;
      for (const ExpectedPart& node : *expected) {
        if (node.state == PartState::kInactive) {
          off.insert(node.node);
        } else if (off_before.contains(node.node)) {
          warnings.push_back(absl::StrCat(place(*mode), "level `", level.name, "` activates ",
                                          node.node, ", which the level before it has off"));
        } else if (is_last && IsSame(in_first, node)) {
          warnings.push_back(absl::StrCat(place(*mode), "level `", level.name,
                                          "` is the most restrictive and leaves ", node.node,
                                          " as it is in the first level"));
        }
        if (is_first) in_first.emplace(node.node, node.parameters);
      }
    }
    off_before = std::move(off);
  }
  return warnings;
}

}  // namespace rips::actuator
