// What actuators say, decoded and free of protobuf.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ACTUATOR_INBOUND_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ACTUATOR_INBOUND_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "services/base/clock.h"
#include "services/base/decision_id.h"
#include "services/ros2/guid.h"

namespace rips::pipeline {

struct ActuatorHello {
  std::vector<std::string> levels;
  std::vector<std::string> programs;
  DecisionId decision_id;
  std::string decided_level;
  std::string effective_level;
  uint64_t highest_term = 0;
  bool state_lost = false;
  // Not a level: `keep`.
  std::string fail_safe_level;
  ros2::Guid participant;
  // Full names of the parts whose modes its levels set.
  std::vector<std::string> protected_parts;
  Instant clock;
  // Its address, as the transport says.
  std::string peer;
};

struct ActuatorHeartbeat {
  // The actuator's own boottime, echoed in the next lease.
  int64_t boottime_ns = 0;
  std::string effective_level;
  std::string observed;
  bool verified = false;
  std::string floor_reason;
  // What does not work although the level may hold, for people. At most kActuatorDegradedMax,
  // printable, kActuatorDegradedBytesMax each.
  std::vector<std::string> degraded;
  // Times a verified level was found left since the actuator started.
  uint64_t drifts = 0;
};

inline constexpr size_t kActuatorDegradedMax = 8;
inline constexpr size_t kActuatorDegradedBytesMax = 256;

struct StepReport {
  // How far a drill went with it.
  enum class Drilled { kNoDrill, kDone, kLooked, kNot };
  std::string step;
  bool ok = false;
  uint32_t took_ms = 0;
  std::string detail;
  Drilled drilled = Drilled::kNoDrill;
  std::string output_tail;

  friend bool operator==(const StepReport&, const StepReport&) = default;
};

struct Receipt {
  enum class Stage {
    kAcknowledged,
    kVerified,
    kFailed,
    kSuperseded,
    kRefusedStale,
    kRefused,
    kUnknown
  };
  // 32 hex digits.
  std::string command_id;
  DecisionId decision_id;
  Stage stage = Stage::kAcknowledged;
  std::vector<StepReport> steps;
  int32_t exit_code = 0;
  std::string output_tail;
  std::string detail;
  std::string effective_level;

  friend bool operator==(const Receipt&, const Receipt&) = default;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ACTUATOR_INBOUND_H_
