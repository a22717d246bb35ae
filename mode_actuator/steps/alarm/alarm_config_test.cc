#include "mode_actuator/steps/alarm/alarm_config.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_macros.h"
#include "services/base/status_matchers.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr absl::string_view kDevices = R"(devices:
  - {name: relay-A1, kind: usb_relay, serial: A1B2C}
  - {name: relay-A2, kind: usb_relay, serial: A1B2C, channel: 2}
  - {name: siren, kind: lcus_serial, path: /dev/serial/by-path/pci-0-port0}
  - {name: lamp, kind: blink1, serial: "20001234"}
)";

struct Parsed {
  std::vector<AlarmSpec> devices;
  AlarmStep step;
  std::vector<ConfigSetting> settings;
};

absl::StatusOr<Parsed> Parse(const std::string& text) {
  ConfigReader reader("a.yaml", text);
  Parsed parsed;
  parsed.devices = ReadAlarmDevices(reader.root());
  const ConfigSection step = reader.root().OptionalSection("alarm");
  if (step.present()) parsed.step = ReadAlarmStep(step, parsed.devices);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  parsed.settings = reader.Settings();
  return parsed;
}

std::string Step(const std::string& step) { return absl::StrCat(kDevices, "alarm: ", step, "\n"); }
std::string Device(const std::string& device) { return absl::StrCat("devices: [", device, "]\n"); }

TEST(AlarmConfigTest, ReadsWhatItSays) {
  const auto parsed = Parse(Step("{device: lamp, state: strobe RED}"));
  ASSERT_THAT(parsed, IsOk());
  EXPECT_THAT(parsed->devices,
              ElementsAre(AlarmSpec{"relay-A1", AlarmKind::kUsbRelay, "A1B2C", "", 1},
                          AlarmSpec{"relay-A2", AlarmKind::kUsbRelay, "A1B2C", "", 2},
                          AlarmSpec{"siren", AlarmKind::kLcusSerial, "",
                                    "/dev/serial/by-path/pci-0-port0", 1},
                          AlarmSpec{"lamp", AlarmKind::kBlink1, "20001234", "", 1}));
  EXPECT_EQ(parsed->step, (AlarmStep{"lamp", {AlarmPattern::kStrobe, {0xff, 0, 0}}}));
  EXPECT_THAT(FormatSettings(parsed->settings), HasSubstr("devices[1].channel: 2"));
}

TEST(AlarmConfigTest, ADrillMayFlashADevice) {
  const auto parsed = Parse(
      "devices:\n"
      "  - {name: a, kind: lcus, serial: x, drill: flash}\n"
      "  - {name: b, kind: lcus, serial: y, drill: look}\n"
      "  - {name: c, kind: lcus, serial: z}\n");
  ASSERT_THAT(parsed, IsOk());
  EXPECT_TRUE(parsed->devices[0].flash_in_drills);
  EXPECT_FALSE(parsed->devices[1].flash_in_drills);
  EXPECT_FALSE(parsed->devices[2].flash_in_drills);
  EXPECT_THAT(Parse("devices:\n  - {name: a, kind: lcus, serial: x, drill: on}\n"),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("drill")));
}

TEST(AlarmConfigTest, OnNeedsNoQuotes) {
  const auto parsed = Parse(Step("{device: siren, state: on}"));
  ASSERT_THAT(parsed, IsOk());
  EXPECT_EQ(parsed->step.state, (AlarmState{AlarmPattern::kOn, {}}));
}

TEST(AlarmConfigTest, SaysWhereEachMistakeIs) {
  const struct {
    std::string text;
    const char* message;
  } kCases[] = {
      {Step("{device: bell, state: \"on\"}"), "a.yaml:6:17: device `bell` is not in `devices`"},
      {Step("{device: relay-A1, state: \"strobe RED\"}"),
       "6:34: `strobe RED` is no state of a usb_relay; did you mean"},
      {Step("{device: lamp, state: \"on\"}"), "`on` is no state of a blink1; did you mean"},
      {Step("{device: lamp}"), "missing key `alarm.state`"},
      {Step("{state: \"on\"}"), "missing key `alarm.device`"},
      {Step("{device: lamp, state: off, channel: 1}"), "unknown key `channel`"},
      {Device("{name: a, kind: usb_relay, serial: x, path: /dev/y}"),
       "exactly one of `serial` and `path`"},
      {Device("{name: a, kind: usb_relay}"), "exactly one of `serial` and `path`"},
      {Device("{name: a, kind: siren, serial: x}"), "`kind` is `siren`; write `usb_relay` or"},
      {Device("{name: a b, kind: lcus, serial: x}"), "`a b` is no device name"},
      {Device("{name: a, kind: usb_relay, serial: A1B2C3}"),
       "`A1B2C3` is no id of a usb_relay: they have at most 5 characters"},
      {Device("{name: " + std::string(65, 'a') + ", kind: lcus, serial: x}"), "no device name"},
      {Device("{kind: lcus, serial: x}"), "missing key `devices[0].name`"},
      {Device("{name: a, kind: lcus, path: dev/x}"), "`dev/x` is not absolute"},
      {Device("{name: a, kind: lcus, path: /dev/hidraw3}"),
       "`/dev/hidraw3` names another device after the next start"},
      {Device("{name: a, kind: lcus_serial, path: /dev/ttyUSB0}"), "names another device"},
      {Device("{name: a, kind: lcus_serial, serial: x}"), "has no serial number; write `path`"},
      {Device("{name: a, kind: lcus, serial: x, channel: 0}"), "`channel`"},
      {Device("{name: a, kind: lcus, serial: x, channel: 9}"), "`channel`"},
      {Device("{name: a, kind: luxafor, serial: x, channel: 1}"), "a luxafor has no channels"},
      {Device("{name: a, kind: lcus, serial: x}, {name: a, kind: lcus, serial: y}"),
       "device `a` is listed twice"},
      {Device("{name: a, kind: lcus, serial: x}, {name: b, kind: lcus, serial: x}"),
       "the same output as device `a`"},
      {Device("{name: a, kind: lcus, serial: " + std::string(kAlarmTextBytesMax + 1, 'x') + "}"),
       "longer than limit 256 bytes"},
  };
  for (const auto& test : kCases) {
    EXPECT_THAT(Parse(test.text),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(test.message)))
        << test.text;
  }
}

TEST(AlarmConfigTest, DevicesHaveALimit) {
  std::string text = "devices:\n";
  for (size_t i = 0; i < kAlarmDevicesMax; ++i) {
    absl::StrAppend(&text, "  - {name: d", i, ", kind: lcus, serial: s", i, "}\n");
  }
  EXPECT_THAT(Parse(text), IsOk());
  absl::StrAppend(&text, "  - {name: more, kind: lcus, serial: more}\n");
  EXPECT_THAT(Parse(text), StatusIs(absl::StatusCode::kInvalidArgument,
                                    HasSubstr("17 devices exceed limit 16")));
}

}  // namespace
}  // namespace rips::actuator
