// The alarms in actuator.yaml.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_CONFIG_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_CONFIG_H_

#include <vector>

#include "absl/time/time.h"
#include "mode_actuator/decide/alarm_state.h"
#include "mode_actuator/decide/level_plan.h"
#include "services/runtime/config_reader.h"

namespace rips::actuator {

inline constexpr size_t kAlarmDevicesMax = 16;
inline constexpr size_t kAlarmTextBytesMax = 256;  // of a serial or path
// Of a step that does not say: one write and one look fit.
inline constexpr absl::Duration kAlarmTimeout = absl::Seconds(1);
inline constexpr int kAlarmRetries = 2;

// `devices: [{name, kind, serial | path, channel}]` of `root`. Problems go to the reader.
std::vector<AlarmSpec> ReadAlarmDevices(const ConfigSection& root);

// `{device: relay-A1, state: "on"}`; the device must be one of `devices` and have that state.
AlarmStep ReadAlarmStep(const ConfigSection& section, const std::vector<AlarmSpec>& devices);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_CONFIG_H_
