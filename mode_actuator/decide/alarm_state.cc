#include "mode_actuator/decide/alarm_state.h"

#include <algorithm>
#include <iterator>

#include "absl/status/status.h"
#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "services/text/nearest.h"

namespace rips::actuator {
namespace {

struct NamedColour {
  absl::string_view name;
  Colour colour;
};
constexpr NamedColour kColours[] = {
    {"RED", {0xff, 0, 0}},        {"ORANGE", {0xff, 0x60, 0}},   {"YELLOW", {0xff, 0xff, 0}},
    {"GREEN", {0, 0xff, 0}},      {"CYAN", {0, 0xff, 0xff}},     {"BLUE", {0, 0, 0xff}},
    {"MAGENTA", {0xff, 0, 0xff}}, {"WHITE", {0xff, 0xff, 0xff}},
};

std::string ColourName(const Colour& colour) {
  for (const NamedColour& each : kColours) {
    if (each.colour == colour) return std::string(each.name);
  }
  return absl::StrFormat("#%02x%02x%02x", colour.red, colour.green, colour.blue);
}

constexpr bool HasARowForEachKindInOrder() {
  for (size_t i = 0; i < std::size(kAlarmKinds); ++i) {
    if (static_cast<size_t>(kAlarmKinds[i].kind) != i) return false;
  }
  return std::size(kAlarmKinds) == kAlarmKindCount;
}
static_assert(HasARowForEachKindInOrder(), "give each AlarmKind its row, in the order of the enum");

}  // namespace

std::vector<std::pair<std::string, AlarmKind>> AlarmKinds() {
  std::vector<std::pair<std::string, AlarmKind>> kinds;
  for (const AlarmKindRow& row : kAlarmKinds) kinds.emplace_back(row.name, row.kind);
  return kinds;
}

std::vector<AlarmState> AlarmStatesOf(AlarmKind kind) {
  std::vector<AlarmState> states = {{AlarmPattern::kOff, {}}};
  if (IsRelay(kind)) {
    states.push_back({AlarmPattern::kOn, {}});
    return states;
  }
  for (const AlarmPattern pattern : {AlarmPattern::kSteady, AlarmPattern::kStrobe}) {
    for (const NamedColour& each : kColours) states.push_back({pattern, each.colour});
  }
  states.push_back({AlarmPattern::kPolice, {}});
  return states;
}

// Of any two names.
constexpr int kFar = 1'000;

absl::StatusOr<AlarmState> ParseAlarmState(AlarmKind kind, absl::string_view text) {
  const absl::string_view cut = text.substr(0, 100);
  int best = kFar + 1;
  std::string nearest;
  for (const AlarmState& state : AlarmStatesOf(kind)) {
    const std::string name = ToString(state);
    if (name == text) return state;
    const int distance =
        EditDistance(absl::AsciiStrToLower(cut), absl::AsciiStrToLower(name), kFar);
    if (distance < best) {
      best = distance;
      nearest = name;
    }
  }
  return absl::InvalidArgumentError(absl::StrCat("`", absl::CHexEscape(cut), "` is no state of a ",
                                                 AlarmKindName(kind), "; did you mean `", nearest,
                                                 "`"));
}

std::string ToString(const AlarmState& state) {
  switch (state.pattern) {
    case AlarmPattern::kOff:
      return "off";
    case AlarmPattern::kOn:
      return "on";
    case AlarmPattern::kSteady:
      return absl::StrCat("steady ", ColourName(state.colour));
    case AlarmPattern::kStrobe:
      return absl::StrCat("strobe ", ColourName(state.colour));
    case AlarmPattern::kPolice:
      return "police";
  }
  return "?";
}

}  // namespace rips::actuator
