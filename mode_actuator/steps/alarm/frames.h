// The bytes that alarm devices understand and answer, apart from how they get there.
//
// HID frames begin with the report id, as hidapi takes and gives them (0 = the device has no report
// ids). What devices answer is not trusted: DataLoss if it is not what the device may say.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_FRAMES_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_FRAMES_H_

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/decide/alarm_state.h"

namespace rips::actuator {

using Frame = std::vector<uint8_t>;

// --- V-USB relay board: feature reports

inline constexpr size_t kUsbRelayFrameBytes = 9;
inline constexpr size_t kUsbRelayIdBytesMax = 5;
// `relay` from 1.
Frame UsbRelayFrame(int relay, bool on);
struct UsbRelayStatus {
  std::string id;      // identifies the board; 1 to 5 printable characters
  uint8_t relays = 0;  // bit 0 = relay 1; set = on
};
absl::StatusOr<UsbRelayStatus> DecodeUsbRelayStatus(std::span<const uint8_t> report);
// Number of relays, 1 to 8, of a board with this product string (`USBRelay2`); nullopt if the
// device is something else: its vendor and product id are shared by many.
std::optional<int> UsbRelayCount(absl::string_view product);

// --- LCUS relay boards: output report or serial line

// `relay` from 1. Without report id.
Frame LcusFrame(int relay, bool on);
inline constexpr uint8_t kLcusQuery = 0xff;
inline constexpr size_t kLcusAnswerBytesMax = 256;
// What a board on a serial line answers to kLcusQuery: `CH1: ON \r\nCH2:OFF\r\n`, or one byte (0 or
// 1) per relay. Element 0 = relay 1; 1 to kAlarmChannelsMax of them.
absl::StatusOr<std::vector<bool>> DecodeLcusStatus(absl::string_view answer);

// --- Luxafor: output report

Frame LuxaforFrame(const AlarmState& state);

// --- blink(1) mk2, mk3: feature report 1

inline constexpr uint8_t kBlink1Report = 1;
inline constexpr size_t kBlink1FrameBytes = 9;
// In the order to send. The light repeats them by itself.
std::vector<Frame> Blink1Frames(const AlarmState& state);
// Questions: the answer is the next feature report read, and repeats the letter of the question.
Frame Blink1AskPlaying();
Frame Blink1AskColour();
Frame Blink1AskLine(uint8_t line);
struct Blink1Playing {
  bool playing = false;
  uint8_t first = 0;  // lines of the pattern, both included
  uint8_t last = 0;
};
absl::StatusOr<Blink1Playing> DecodeBlink1Playing(std::span<const uint8_t> report);
// `question` is the frame that was sent: the colour now, or of a line.
absl::StatusOr<Colour> DecodeBlink1Colour(const Frame& question, std::span<const uint8_t> report);
// The state that shows this; `lines` are lines 0 and 1, used if `playing.playing`. nullopt if
// it is none of AlarmStatesOf(kBlink1).
std::optional<AlarmState> Blink1State(const Blink1Playing& playing, const Colour& now,
                                      std::span<const Colour> lines);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_FRAMES_H_
