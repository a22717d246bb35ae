// Alarms by devices that may be slow, stuck, absent, unplugged and plugged in again.
//
// Each device has a thread of its own, the only one that talks to it: orders of several channels
// of one board are carried out one by one. It opens the device when it is first needed after it
// was lost, by finding it anew; a device that fails is closed. A thread that the kernel does not
// give back delays only the callers that wait for its device, and them not for longer than
// kAlarmIoBudget.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_BOARD_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_BOARD_H_

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/time/time.h"
#include "mode_actuator/steps/alarm/alarm_device.h"
#include "mode_actuator/steps/port/alarms.h"
#include "services/base/clock.h"

namespace rips::actuator {

// What the end of an AlarmBoard waits for a device. A thread that is stuck even then is left
// behind; it holds what it needs and ends when the kernel lets it.
inline constexpr absl::Duration kAlarmStopWait = absl::Seconds(1);

class AlarmBoard final : public Alarms {
 public:
  // Starts the threads, which look for their devices at once. A device that is not there is logged,
  // and found when it comes. `clock` is not owned and outlives this; its boottime must really pass.
  // Another `io_budget` is for tests of devices that are not slow, on machines that are.
  AlarmBoard(const std::vector<AlarmSpec>& alarms, const OpenAlarm& open, const Clock* clock,
             absl::Duration io_budget = kAlarmIoBudget);
  ~AlarmBoard() override;

  absl::StatusOr<uint64_t> Begin(absl::string_view alarm, AlarmOrder order,
                                 const AlarmState& state) override;
  std::optional<AlarmResult> Poll(uint64_t order) override;
  void Drop(uint64_t order) override;
  void Leave(uint64_t order) override;

  // Devices that could not be used when that was last tried. Any thread.
  size_t missing() const;

 private:
  class Line;  // one device
  struct Alarm {
    AlarmSpec spec;
    std::shared_ptr<Line> line;
  };

  std::vector<std::shared_ptr<Line>> lines_;
  std::map<std::string, Alarm, std::less<>> alarms_;
  std::map<uint64_t, std::shared_ptr<Line>> orders_;  // begun, not over
  uint64_t next_order_ = 1;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_ALARM_BOARD_H_
