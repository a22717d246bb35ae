#include "mode_actuator/steps/mode_survey.h"

#include <algorithm>
#include <cstdint>
#include <map>
#include <utility>
#include <variant>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {
namespace {

constexpr size_t kModeBytesShown = 64;

// mode -> index of the level it shows
using ShownLevels = std::map<std::string, int>;

// The modes in which `steps` leave each part.
std::map<std::string, std::string> ModesAfter(const std::vector<Step>& steps) {
  std::map<std::string, std::string> modes;
  for (const Step& step : steps) {
    if (const auto* mode = std::get_if<SystemModeStep>(&step.what)) modes[mode->part] = mode->mode;
  }
  return modes;
}

std::map<std::string, ShownLevels> ShownByPart(const std::vector<LevelSpec>& levels) {
  std::map<std::string, ShownLevels> shown;
  for (const auto steps : {&LevelSpec::enter, &LevelSpec::on_drift}) {
    for (size_t i = 0; i < levels.size(); ++i) {
      for (const auto& [part, mode] : ModesAfter(levels[i].*steps)) {
        shown[part].try_emplace(mode, static_cast<int>(i));
      }
    }
  }
  return shown;
}

struct Shown {
  int level = -1;  // -1 = none
  std::string mode;
};

Shown Of(const ShownLevels& levels, const std::string& mode) {
  const auto found = levels.find(mode);
  return found == levels.end() ? Shown{-1, mode} : Shown{found->second, mode};
}

Shown Judge(const ShownLevels& levels, const PartReading& reading) {
  Shown by_nodes;
  for (const std::string& mode : reading.agreeing) {
    const Shown shown = Of(levels, mode);
    if (shown.level >= 0 && (by_nodes.level < 0 || shown.level < by_nodes.level)) by_nodes = shown;
  }
  const Shown by_manager = Of(levels, reading.named);
  return by_nodes.level >= 0 && by_nodes.level >= by_manager.level ? by_nodes : by_manager;
}

// Reads each part of `shown`, again and again until that gives nothing better.
std::map<std::string, PartReading> ReadParts(const std::map<std::string, ShownLevels>& shown,
                                             PartModes& modes, const Clock& clock,
                                             const CancelFlag& cancel) {
  std::map<std::string, PartReading> readings;
  const int64_t end_ns = clock.Now().boottime_ns + absl::ToInt64Nanoseconds(kSurveyTime);
  while (true) {
    bool complete = true;
    for (const auto& [part, unused] : shown) {
      const int64_t left_ns = end_ns - clock.Now().boottime_ns;
      if (cancel.cancelled() || left_ns <= 0) return readings;
      PartReading& best = readings[part];
      if (best.complete) continue;
      PartReading reading = modes.Read(part, absl::Nanoseconds(left_ns), cancel);
      // One that the end of the time has cut short is not a better one.
      if (reading.answers >= best.answers) best = std::move(reading);
      complete &= best.complete;
    }
    if (complete) return readings;
    const absl::Duration left = absl::Nanoseconds(end_ns - clock.Now().boottime_ns);
    cancel.WaitFor(std::clamp(left, absl::ZeroDuration(), kSurveyPeriod));
  }
}

}  // namespace

ModeSurvey SurveyModes(const std::vector<LevelSpec>& levels, PartModes& modes, const Clock& clock,
                       const CancelFlag& cancel) {
  const std::map<std::string, ShownLevels> shown = ShownByPart(levels);
  const std::map<std::string, PartReading> readings = ReadParts(shown, modes, clock, cancel);
  ModeSurvey survey;
  int highest = -1;
  for (const auto& [part, reading] : readings) {
    const Shown found = Judge(shown.at(part), reading);
    if (found.level > highest) highest = found.level;
    const absl::string_view mode = absl::string_view(found.mode).substr(0, kModeBytesShown);
    absl::StrAppend(&survey.observed, survey.observed.empty() ? "" : " ", part, "=",
                    mode.empty() ? "?" : absl::CHexEscape(mode));
  }
  if (highest >= 0) survey.level = levels[highest].name;
  return survey;
}

}  // namespace rips::actuator
