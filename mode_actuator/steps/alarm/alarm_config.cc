#include "mode_actuator/steps/alarm/alarm_config.h"

#include <algorithm>
#include <map>
#include <set>
#include <string>
#include <tuple>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/steps/alarm/frames.h"
#include "services/text/quote.h"

namespace rips::actuator {
namespace {

constexpr size_t kNameBytesMax = 64;

bool IsDeviceName(absl::string_view name) {
  if (name.empty() || name.size() > kNameBytesMax) return false;
  return std::all_of(name.begin(), name.end(),
                     [](char c) { return absl::ascii_isalnum(c) || c == '_' || c == '-'; });
}

// `/dev/hidraw3`, `/dev/ttyUSB0`: numbers that the kernel gives in the order of plugging in.
bool IsNumberedNode(absl::string_view path) {
  for (const absl::string_view prefix : {"/dev/hidraw", "/dev/ttyUSB", "/dev/ttyACM"}) {
    if (!absl::StartsWith(path, prefix)) continue;
    const absl::string_view rest = path.substr(prefix.size());
    return std::all_of(rest.begin(), rest.end(), absl::ascii_isdigit);
  }
  return false;
}

void ReadIdentity(const ConfigSection& section, AlarmSpec* device) {
  section.Optional("serial", &device->serial);
  section.Optional("path", &device->path);
  if (device->serial.empty() == device->path.empty()) {
    section.Problem("", "a device needs exactly one of `serial` and `path`");
    return;
  }
  if (std::max(device->serial.size(), device->path.size()) > kAlarmTextBytesMax) {
    section.Problem(device->serial.empty() ? "path" : "serial",
                    absl::StrCat("longer than limit ", kAlarmTextBytesMax, " bytes"));
  }
  if (device->path.empty()) {
    if (device->kind == AlarmKind::kLcusSerial) {
      section.Problem("serial", "an lcus_serial has no serial number; write `path`");
    } else if (device->kind == AlarmKind::kUsbRelay &&
               device->serial.size() > kUsbRelayIdBytesMax) {
      section.Problem("serial", absl::StrCat(QuoteBytes(device->serial),
                                             " is no id of a usb_relay: they "
                                             "have at most ",
                                             kUsbRelayIdBytesMax, " characters"));
    }
  } else if (device->path.front() != '/') {
    section.Problem("path", absl::StrCat(QuoteBytes(device->path), " is not absolute"));
  } else if (IsNumberedNode(device->path)) {
    section.Problem("path", absl::StrCat(QuoteBytes(device->path),
                                         " names another device after the "
                                         "next start; use `serial`, or a link that udev keeps"));
  }
}

AlarmSpec ReadDevice(const ConfigSection& section) {
  AlarmSpec device;
  section.Required("name", &device.name);
  if (!device.name.empty() && !IsDeviceName(device.name)) {
    section.Problem("name", absl::StrCat(QuoteBytes(device.name),
                                         " is no device name; use letters, digits, `_` and `-`"));
  }
  section.RequiredEnum<AlarmKind>("kind", &device.kind, AlarmKinds());
  ReadIdentity(section, &device);
  section.OptionalEnum<bool>("drill", &device.flash_in_drills, {{"look", false}, {"flash", true}});
  if (IsRelay(device.kind)) {
    section.Optional("channel", &device.channel, {1, kAlarmChannelsMax});
  } else if (section.Has("channel")) {
    section.Optional("channel", &device.channel, {1, kAlarmChannelsMax});
    section.Problem("channel", absl::StrCat("a ", AlarmKindName(device.kind), " has no channels"));
  }
  return device;
}

}  // namespace

std::vector<AlarmSpec> ReadAlarmDevices(const ConfigSection& root) {
  const std::vector<ConfigSection> sections = root.Sections("devices");
  if (sections.size() > kAlarmDevicesMax) {
    root.Problem("devices",
                 absl::StrCat(sections.size(), " devices exceed limit ", kAlarmDevicesMax));
  }
  std::vector<AlarmSpec> devices;
  std::set<std::string> names;
  std::map<std::tuple<AlarmKind, std::string, std::string, int>, std::string> outputs;
  for (const ConfigSection& section : sections) {
    AlarmSpec device = ReadDevice(section);
    if (!device.name.empty() && !names.insert(device.name).second) {
      section.Problem("name", absl::StrCat("device ", QuoteBytes(device.name), " is listed twice"));
    }
    const auto [same, added] = outputs.emplace(
        std::tuple(device.kind, device.serial, device.path, device.channel), device.name);
    if (!added && !(device.serial.empty() && device.path.empty())) {
      section.Problem("", absl::StrCat("the same output as device ", QuoteBytes(same->second)));
    }
    devices.push_back(std::move(device));
  }
  return devices;
}

AlarmStep ReadAlarmStep(const ConfigSection& section, const std::vector<AlarmSpec>& devices) {
  AlarmStep step;
  std::string state;
  section.Required("device", &step.device);
  section.Required("state", &state);
  const AlarmSpec* device = FindNamed(devices, step.device);
  if (device == nullptr) {
    if (!step.device.empty()) {
      section.Problem("device",
                      absl::StrCat("device ", QuoteBytes(step.device), " is not in `devices`"));
    }
    return step;
  }
  if (state.empty()) return step;
  const absl::StatusOr<AlarmState> parsed = ParseAlarmState(device->kind, state);
  if (parsed.ok()) {
    step.state = *parsed;
  } else {
    section.Problem("state", parsed.status().message());
  }
  return step;
}

}  // namespace rips::actuator
