// The alarm devices that are known, each as an AlarmDevice.
//
// | kind        | identified by                | read back                                   |
// |-------------|------------------------------|---------------------------------------------|
// | usb_relay   | the id the board answers     | always                                      |
// | lcus        | USB serial number            | never                                       |
// | lcus_serial | path only                    | if the board answers the query once         |
// | luxafor     | USB serial number            | never                                       |
// | blink1      | USB serial number            | always                                      |
// All of them also by `path`. What cannot be read back is at least seen to be plugged in.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_DRIVERS_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_DRIVERS_H_

#include "mode_actuator/steps/alarm/alarm_device.h"

namespace rips::actuator {

// Opens real devices. May be called from several threads, each with its own gate; hidapi is shared
// by copies and by the devices opened, and given up with the last of them.
OpenAlarm RealAlarms();

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_DRIVERS_H_
