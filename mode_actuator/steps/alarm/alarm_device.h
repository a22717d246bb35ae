// Port: one alarm device that is plugged in and opened.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_DEVICE_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_DEVICE_H_

#include <functional>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "mode_actuator/decide/alarm_state.h"
#include "mode_actuator/steps/alarm/io_gate.h"

namespace rips::actuator {

struct AlarmReading {
  enum class Answer {
    kAsWanted,
    kOther,
    kUnreadable,  // the device is there, but cannot be asked
  };
  Answer answer = Answer::kUnreadable;
  std::string subject;   // `relay 1`, `the light`
  std::string observed;  // `on`, `steady RED`; empty if kUnreadable
};

// One thread at a time. Any call may block for as long as the kernel does. Every exchange is
// announced to the gate it was opened with. After a status other than OK, InvalidArgument and
// OutOfRange the device must be closed (destroyed) and opened anew.
class AlarmDevice {
 public:
  virtual ~AlarmDevice() = default;

  // `channel` counts from 1; lights do not look at it. OutOfRange if the board has no such relay,
  // Unavailable if the system says no, Aborted if the gate is closed.
  virtual absl::Status Set(int channel, const AlarmState& state) = 0;
  // Asks. Also DataLoss if the answer makes no sense.
  virtual absl::StatusOr<AlarmReading> Read(int channel, const AlarmState& wanted) = 0;
};

// Finds the device of `spec` among those plugged in, by its serial or path, and opens it. NotFound
// if it is not there, or something else is; Unavailable if it cannot be identified or opened.
using OpenAlarm =
    std::function<absl::StatusOr<std::unique_ptr<AlarmDevice>>(const AlarmSpec&, IoGate*)>;

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_DEVICE_H_
