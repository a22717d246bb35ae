// Which alarm devices there are, and the states that a step can ask of them.
//
// | state           | relays | lights |
// |-----------------|--------|--------|
// | `off`           | yes    | yes    |
// | `on`            | yes    | no     |
// | `steady COLOUR` | no     | yes    |
// | `strobe COLOUR` | no     | yes    |
// | `police`        | no     | yes    | red and blue by turns
// COLOUR is RED, ORANGE, YELLOW, GREEN, CYAN, BLUE, MAGENTA or WHITE.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_ALARM_STATE_H_
#define RIPS_MODE_ACTUATOR_DECIDE_ALARM_STATE_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::actuator {

// Boards have up to this many relays; also the highest channel.
inline constexpr int kAlarmChannelsMax = 8;

// In the order of kAlarmKinds.
enum class AlarmKind { kUsbRelay, kLcus, kLcusSerial, kLuxafor, kBlink1 };
inline constexpr size_t kAlarmKindCount = static_cast<size_t>(AlarmKind::kBlink1) + 1;

// USB vendor and product of a kind.
struct UsbId {
  uint16_t vendor = 0;
  uint16_t product = 0;
  friend bool operator==(const UsbId&, const UsbId&) = default;
};

// The kernel's class of a device node. The driver, the udev rules and rips-actuator.service agree
// on it.
enum class AlarmBus { kHidraw, kTty };

struct AlarmKindRow {
  AlarmKind kind;
  absl::string_view name;
  UsbId usb;
  bool is_relay;
  AlarmBus bus;
};
inline constexpr AlarmKindRow kAlarmKinds[] = {
    // V-USB relay board with 1 to 8 relays, product `USBRelayN`
    {AlarmKind::kUsbRelay, "usb_relay", {0x16c0, 0x05df}, true, AlarmBus::kHidraw},
    // LCUS relay board that is a HID device
    {AlarmKind::kLcus, "lcus", {0x5131, 0x2007}, true, AlarmBus::kHidraw},
    // LCUS relay board behind a CH340 serial converter
    {AlarmKind::kLcusSerial, "lcus_serial", {0x1a86, 0x7523}, true, AlarmBus::kTty},
    // Luxafor Flag and its kin
    {AlarmKind::kLuxafor, "luxafor", {0x04d8, 0xf372}, false, AlarmBus::kHidraw},
    // blink(1) mk2 and mk3
    {AlarmKind::kBlink1, "blink1", {0x27b8, 0x01ed}, false, AlarmBus::kHidraw},
};

constexpr const AlarmKindRow& RowOf(AlarmKind kind) {
  return kAlarmKinds[static_cast<size_t>(kind)];
}
constexpr UsbId UsbIdOf(AlarmKind kind) { return RowOf(kind).usb; }
constexpr AlarmBus BusOf(AlarmKind kind) { return RowOf(kind).bus; }
constexpr bool IsRelay(AlarmKind kind) { return RowOf(kind).is_relay; }
// `usb_relay`.
constexpr absl::string_view AlarmKindName(AlarmKind kind) { return RowOf(kind).name; }
// Every kind with its name.
std::vector<std::pair<std::string, AlarmKind>> AlarmKinds();

struct Colour {
  uint8_t red = 0;
  uint8_t green = 0;
  uint8_t blue = 0;
  friend bool operator==(const Colour&, const Colour&) = default;
};

enum class AlarmPattern { kOff, kOn, kSteady, kStrobe, kPolice };

struct AlarmState {
  AlarmPattern pattern = AlarmPattern::kOff;
  Colour colour;  // of kSteady and kStrobe
  friend bool operator==(const AlarmState&, const AlarmState&) = default;
};

// Every state of `kind`, in the order of the table above.
std::vector<AlarmState> AlarmStatesOf(AlarmKind kind);
// InvalidArgument if `text` is none of them, with the nearest one.
absl::StatusOr<AlarmState> ParseAlarmState(AlarmKind kind, absl::string_view text);
// Inverse of ParseAlarmState: `strobe RED`; a colour without a name is `#0a141e`.
std::string ToString(const AlarmState& state);

// One alarm of `devices` in actuator.yaml. Several may be channels of one board.
struct AlarmSpec {
  std::string name;
  AlarmKind kind = AlarmKind::kUsbRelay;
  std::string serial;  // exactly one of `serial` and `path` is set
  std::string path;    // a link that udev keeps, never /dev/hidrawN
  int channel = 1;     // relays: 1 to kAlarmChannelsMax
  // A drill may switch it on for a moment, and off again.
  bool flash_in_drills = false;
  friend bool operator==(const AlarmSpec&, const AlarmSpec&) = default;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_ALARM_STATE_H_
