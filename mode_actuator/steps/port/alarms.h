// Port: switching the alarms of `devices`, and looking at them.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PORT_ALARMS_H_
#define RIPS_MODE_ACTUATOR_STEPS_PORT_ALARMS_H_

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/alarm_state.h"

namespace rips::actuator {

// One exchange with a device; one that takes longer has failed.
inline constexpr absl::Duration kAlarmIoBudget = absl::Milliseconds(500);
// Orders waiting for one device, the running one included.
inline constexpr size_t kAlarmOrdersMax = 8;

struct AlarmResult {
  // OK: the alarm is as wanted, or was set and cannot be read. NotFound: no such device is
  // plugged in. FailedPrecondition: it was read back and is otherwise, or it was plugged in again
  // and has not been set since. DataLoss: it answers garbage. DeadlineExceeded: it does not
  // answer. Unavailable: the system says no.
  absl::Status status;
  // `relay 1 is on (read back)`, `sent; this device cannot be read back`; empty if not OK.
  std::string detail;
  // The state read back, or `?`.
  std::string observed = "?";
};

enum class AlarmOrder {
  kSet,   // bring it into the state, and read it back if it can be
  kRead,  // only read it back
};

// Orders of one device are carried out in the order of Begin. One thread at a time.
class Alarms {
 public:
  virtual ~Alarms() = default;

  // Never blocks. NotFound if `alarm` is none of `devices`, ResourceExhausted if kAlarmOrdersMax
  // orders wait already.
  virtual absl::StatusOr<uint64_t> Begin(absl::string_view alarm, AlarmOrder order,
                                         const AlarmState& state) = 0;
  // The result, once; nullopt while it is not over. It is DeadlineExceeded as soon as one
  // exchange of the device takes longer than kAlarmIoBudget; what waited behind it is not sent.
  virtual std::optional<AlarmResult> Poll(uint64_t order) = 0;
  // The caller gives up: frames not sent yet are not sent.
  virtual void Drop(uint64_t order) = 0;
  // The caller gives up, but the order is carried out.
  virtual void Leave(uint64_t order) = 0;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PORT_ALARMS_H_
