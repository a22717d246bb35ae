#include "mode_actuator/steps/alarm/frames.h"

#include <algorithm>

#include "absl/status/status.h"
#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace rips::actuator {
namespace {

// How long each of two lines of a blinking blink(1) lasts, in 10 ms.
constexpr uint8_t kBlink1LineTime = 25;
// Time of one flash of a Luxafor strobe; the unit is the device's.
constexpr uint8_t kLuxaforSpeed = 10;
constexpr uint8_t kLuxaforAllLeds = 0xff;
constexpr uint8_t kLuxaforForever = 0;
constexpr uint8_t kLuxaforPolice = 5;

constexpr Colour kRed = {0xff, 0, 0};
constexpr Colour kBlue = {0, 0, 0xff};
constexpr Colour kDark = {0, 0, 0};

absl::Status Garbage(absl::string_view what, std::span<const uint8_t> bytes) {
  const size_t shown = std::min<size_t>(bytes.size(), 16);
  const std::string text(bytes.begin(), bytes.begin() + static_cast<ptrdiff_t>(shown));
  return absl::DataLossError(absl::StrCat("the answer of ", what, " is invalid: ", bytes.size(),
                                          " bytes `", absl::BytesToHexString(text), "`"));
}

Frame Blink1Line(uint8_t line, const Colour& colour) {
  return {kBlink1Report, 'P', colour.red, colour.green, colour.blue, 0, kBlink1LineTime, line, 0};
}

Frame Blink1Play(bool play) {
  return {kBlink1Report, 'p', static_cast<uint8_t>(play ? 1 : 0), 0, 1, 0, 0, 0, 0};
}

bool IsBlink1Answer(uint8_t letter, std::span<const uint8_t> report) {
  // Some kernels and firmwares leave out the unused last byte.
  return (report.size() == kBlink1FrameBytes || report.size() == kBlink1FrameBytes - 1) &&
         report[0] == kBlink1Report && report[1] == letter;
}

// `CH12: ON ` -> true; sets `*relay`.
std::optional<bool> DecodeLcusLine(absl::string_view line, int* relay) {
  line = absl::StripAsciiWhitespace(line);
  if (line.size() < 6 || !absl::StartsWithIgnoreCase(line, "CH") || line[3] != ':') {
    return std::nullopt;
  }
  *relay = line[2] - '0';
  const absl::string_view state = absl::StripAsciiWhitespace(line.substr(4));
  if (absl::EqualsIgnoreCase(state, "ON")) return true;
  if (absl::EqualsIgnoreCase(state, "OFF")) return false;
  return std::nullopt;
}

}  // namespace

Frame UsbRelayFrame(int relay, bool on) {
  const uint8_t verb = on ? 0xff : 0xfd;
  return {0, verb, static_cast<uint8_t>(relay), 0, 0, 0, 0, 0, 0};
}

absl::StatusOr<UsbRelayStatus> DecodeUsbRelayStatus(std::span<const uint8_t> report) {
  if (report.size() != kUsbRelayFrameBytes || report[0] != 0) {
    return Garbage("a usb_relay", report);
  }
  UsbRelayStatus status;
  for (size_t i = 1; i <= kUsbRelayIdBytesMax && report[i] != 0; ++i) {
    status.id.push_back(static_cast<char>(report[i]));
  }
  if (status.id.empty() || !std::all_of(status.id.begin(), status.id.end(), absl::ascii_isgraph)) {
    return Garbage("a usb_relay", report);
  }
  status.relays = report[8];
  return status;
}

std::optional<int> UsbRelayCount(absl::string_view product) {
  constexpr absl::string_view kPrefix = "USBRelay";
  if (product.size() != kPrefix.size() + 1 || !absl::StartsWith(product, kPrefix)) {
    return std::nullopt;
  }
  const int count = product.back() - '0';
  if (count < 1 || count > kAlarmChannelsMax) return std::nullopt;
  return count;
}

Frame LcusFrame(int relay, bool on) {
  const auto channel = static_cast<uint8_t>(relay);
  const uint8_t verb = on ? 1 : 0;
  return {0xa0, channel, verb, static_cast<uint8_t>(0xa0 + channel + verb)};
}

absl::StatusOr<std::vector<bool>> DecodeLcusStatus(absl::string_view answer) {
  const auto* bytes = reinterpret_cast<const uint8_t*>(answer.data());
  const absl::Status garbage = Garbage("an LCUS board", {bytes, answer.size()});
  if (answer.empty()) return garbage;
  std::vector<bool> relays;
  if (answer[0] == 0 || answer[0] == 1) {
    for (const char state : answer) {
      if (state != 0 && state != 1) return garbage;
      relays.push_back(state == 1);
    }
  } else {
    for (const absl::string_view line : absl::StrSplit(answer, '\n', absl::SkipWhitespace())) {
      int relay = 0;
      const std::optional<bool> on = DecodeLcusLine(line, &relay);
      if (!on.has_value() || relay != static_cast<int>(relays.size()) + 1) return garbage;
      relays.push_back(*on);
    }
  }
  if (relays.empty() || relays.size() > static_cast<size_t>(kAlarmChannelsMax)) return garbage;
  return relays;
}

Frame LuxaforFrame(const AlarmState& state) {
  const Colour& colour = state.colour;
  switch (state.pattern) {
    case AlarmPattern::kSteady:
      return {0, 1, kLuxaforAllLeds, colour.red, colour.green, colour.blue, 0, 0, 0};
    case AlarmPattern::kStrobe:
      return {0,
              3,
              kLuxaforAllLeds,
              colour.red,
              colour.green,
              colour.blue,
              kLuxaforSpeed,
              0,
              kLuxaforForever};
    case AlarmPattern::kPolice:
      return {0, 6, kLuxaforPolice, kLuxaforForever, 0, 0, 0, 0, 0};
    case AlarmPattern::kOff:
    case AlarmPattern::kOn:
      break;
  }
  return {0, 1, kLuxaforAllLeds, 0, 0, 0, 0, 0, 0};
}

std::vector<Frame> Blink1Frames(const AlarmState& state) {
  Colour first = state.colour;
  Colour second = kDark;
  switch (state.pattern) {
    case AlarmPattern::kStrobe:
      break;
    case AlarmPattern::kPolice:
      first = kRed;
      second = kBlue;
      break;
    case AlarmPattern::kSteady:
    case AlarmPattern::kOff:
    case AlarmPattern::kOn: {
      const Colour now = state.pattern == AlarmPattern::kSteady ? state.colour : kDark;
      // A pattern that plays would paint over the colour.
      return {Blink1Play(false), {kBlink1Report, 'n', now.red, now.green, now.blue, 0, 0, 0, 0}};
    }
  }
  return {Blink1Line(0, first), Blink1Line(1, second), Blink1Play(true)};
}

Frame Blink1AskPlaying() { return {kBlink1Report, 'S', 0, 0, 0, 0, 0, 0, 0}; }
Frame Blink1AskColour() { return {kBlink1Report, 'r', 0, 0, 0, 0, 0, 0, 0}; }
Frame Blink1AskLine(uint8_t line) { return {kBlink1Report, 'R', 0, 0, 0, 0, 0, line, 0}; }

absl::StatusOr<Blink1Playing> DecodeBlink1Playing(std::span<const uint8_t> report) {
  if (!IsBlink1Answer('S', report) || report[2] > 1) return Garbage("a blink1", report);
  return Blink1Playing{.playing = report[2] == 1, .first = report[3], .last = report[4]};
}

absl::StatusOr<Colour> DecodeBlink1Colour(const Frame& question, std::span<const uint8_t> report) {
  if (!IsBlink1Answer(question[1], report)) return Garbage("a blink1", report);
  return Colour{report[2], report[3], report[4]};
}

std::optional<AlarmState> Blink1State(const Blink1Playing& playing, const Colour& now,
                                      std::span<const Colour> lines) {
  if (!playing.playing) {
    if (now == kDark) return AlarmState{AlarmPattern::kOff, {}};
    return AlarmState{AlarmPattern::kSteady, now};
  }
  if (playing.first != 0 || playing.last != 1 || lines.size() < 2) return std::nullopt;
  if (lines[0] == kRed && lines[1] == kBlue) return AlarmState{AlarmPattern::kPolice, {}};
  if (lines[0] == kDark || lines[1] != kDark) return std::nullopt;
  return AlarmState{AlarmPattern::kStrobe, lines[0]};
}

}  // namespace rips::actuator
