// Receipt, ActuatorHello, ActuatorHeartbeat: what an actuator sends the server, as plain values.
// Actuator, server and simulation share these structs; rips.v1 (command.proto, actuator.proto) is
// their wire form.
#ifndef RIPS_SERVICES_MODEL_RECEIPT_H_
#define RIPS_SERVICES_MODEL_RECEIPT_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "services/base/clock.h"
#include "services/base/decision_id.h"
#include "services/model/audit_head.h"
#include "services/ros2/guid.h"

namespace rips::model {

// How far a drill went with a step. Values as in rips.v1.StepResult.Drilled.
enum class Drilled : uint8_t {
  kNoDrill = 0,  // carried out
  kDone = 1,     // carried out as a drill, or carried out and taken back
  kLooked = 2,   // looked only whether what it needs is there and answers
  kNot = 3,      // not tried
};

struct StepResult {
  // `system_mode /safety=ALERT`, `program usb_alarm`
  std::string step;
  bool ok = false;
  uint32_t took_ms = 0;
  std::string detail;
  Drilled drilled = Drilled::kNoDrill;
  // Of a program.
  std::string output_tail;

  friend bool operator==(const StepResult&, const StepResult&) = default;
};

struct Receipt {
  // Values as in rips.v1.Receipt.Stage, and in the actuator's journal.
  enum class Stage : uint8_t {
    kAcknowledged = 1,
    kVerified = 2,
    kFailed = 3,
    kSuperseded = 4,
    kRefusedStale = 5,
    kRefused = 6,
    kUnknown = 7,
  };
  // As Command::id.
  std::string command_id;
  // None for programs.
  DecisionId decision_id;
  Stage stage = Stage::kAcknowledged;
  std::vector<StepResult> steps;
  // Of a program; 128 + signal if it was killed.
  int32_t exit_code = 0;
  std::string output_tail;
  std::string detail;
  std::string effective_level;

  friend bool operator==(const Receipt&, const Receipt&) = default;
};

// Parts that a level has inactive.
struct InactiveParts {
  std::string level;
  // Full names.
  std::vector<std::string> parts;

  friend bool operator==(const InactiveParts&, const InactiveParts&) = default;
};
// Of ActuatorHello.
inline constexpr size_t kTopicsWhileInactiveMax = 64;

struct ActuatorHello {
  std::vector<std::string> levels;
  std::vector<std::string> programs;
  // The newest decision held; none if the state was lost.
  DecisionId decision_id;
  std::string decided_level;
  std::string effective_level;
  uint64_t highest_term = 0;
  bool state_lost = false;
  // Not a level: `keep`.
  std::string fail_safe_level;
  // All zero without DDS.
  ros2::Guid participant;
  // Full names of the parts whose modes its levels set.
  std::vector<std::string> protected_parts;
  // What each level has inactive, of protected_parts; empty = not known.
  std::vector<InactiveParts> inactive_parts;
  // Topics that these parts publish all the same.
  std::vector<std::string> published_while_inactive;
  // The newest that a server granted a lease with.
  AuditHead last_audit_head;
  Instant clock;
  // Its address, as the transport says; not on the wire.
  std::string peer;
};

// A source address that was kept out in the last 10 min.
struct DropSource {
  // IPv4 or IPv6, as text. UDP lets a sender write what it likes there.
  std::string address;
  // Since it began to send; a pause of 10 min begins anew.
  uint64_t packets = 0;
  // At least so long nothing from it was dropped.
  uint32_t quiet_s = 0;

  friend bool operator==(const DropSource&, const DropSource&) = default;
};

inline constexpr size_t kDropSourcesMax = 24;
inline constexpr size_t kDropAddressBytesMax = 45;

// Of the firewall of the level that an actuator holds.
struct FirewallDrops {
  // Dropped on their way in, for the last `counted_s`.
  uint64_t packets = 0;
  uint32_t counted_s = 0;
  // At least so long no packet was dropped.
  uint32_t quiet_s = 0;
  // From whom, the newest first, at most kDropSourcesMax; and how many others.
  std::vector<DropSource> sources;
  uint32_t more_sources = 0;

  friend bool operator==(const FirewallDrops&, const FirewallDrops&) = default;
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
  // Absent: its level has no firewall, or it was not looked at yet.
  std::optional<FirewallDrops> firewall_drops;
};

inline constexpr size_t kActuatorDegradedMax = 8;
inline constexpr size_t kActuatorDegradedBytesMax = 256;

}  // namespace rips::model

#endif  // RIPS_SERVICES_MODEL_RECEIPT_H_
