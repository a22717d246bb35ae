// A serial line that alarm boards hang on: 9600 baud, 8 data bits, no parity, 1 stop bit, raw.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_TTY_CHANNEL_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_TTY_CHANNEL_H_

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/alarm/frames.h"
#include "mode_actuator/steps/alarm/io_gate.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {

// One thread at a time. Never blocks longer than kAlarmIoBudget. Unavailable if the line is gone,
// DeadlineExceeded if it takes nothing, Aborted if the gate is closed.
class TtyChannel {
 public:
  // NotFound if there is no `path` or it is no terminal, Unavailable if it cannot be opened or set
  // up. Only root can open it afterwards. `gate` is not
  // owned and outlives this.
  static absl::StatusOr<std::unique_ptr<TtyChannel>> Open(const std::string& path, IoGate* gate);

  absl::Status Write(const Frame& frame);
  // Forgets what has come, writes `question`, and collects what comes then: until `first_wait` has
  // passed without anything, kQuiet after the last byte, or kAnswerTime in all. Empty if nothing
  // came. ResourceExhausted if more than kLcusAnswerBytesMax came.
  absl::StatusOr<std::string> Ask(const Frame& question, absl::Duration first_wait);
  // OK as long as the line is there.
  absl::Status Probe();

  // Between two bytes of one answer.
  static constexpr absl::Duration kQuiet = absl::Milliseconds(50);
  // One answer; the longest that a board gives takes 90 ms.
  static constexpr absl::Duration kAnswerTime = absl::Milliseconds(400);

 private:
  TtyChannel(UniqueFd fd, IoGate* gate) : fd_(std::move(fd)), gate_(gate) {}
  absl::Status WriteAll(const Frame& frame);

  const UniqueFd fd_;
  IoGate* const gate_;  // Not owned; outlives this.
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_TTY_CHANNEL_H_
