// Command, LeaseGrant: what the server sends an actuator, as plain values. Server, actuator and
// simulation share these structs; rips.v1 (command.proto, actuator.proto) is their wire form.
#ifndef RIPS_SERVICES_MODEL_COMMAND_H_
#define RIPS_SERVICES_MODEL_COMMAND_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "services/base/decision_id.h"
#include "services/model/audit_head.h"

namespace rips::model {

inline constexpr size_t kCommandIdHexDigits = 32;

struct SetLevel {
  DecisionId decision_id;
  std::string from;
  std::string to;
  std::string cause;
  // None unless `to` is below what the actuator holds.
  DecisionId based_on;

  friend bool operator==(const SetLevel&, const SetLevel&) = default;
};

struct RunProgram {
  std::string program;
  std::vector<std::string> args;
  // 0 = the program's own.
  uint32_t timeout_ms = 0;

  friend bool operator==(const RunProgram&, const RunProgram&) = default;
};

// Tries what `level` does without doing it.
struct Drill {
  std::string level;

  friend bool operator==(const Drill&, const Drill&) = default;
};

struct Command {
  // kCommandIdHexDigits, lower case.
  std::string id;
  // The fencing token.
  uint64_t term = 0;
  uint32_t ttl_ms = 0;
  std::variant<SetLevel, RunProgram, Drill> what;

  friend bool operator==(const Command&, const Command&) = default;
};

struct LeaseGrant {
  // CLOCK_BOOTTIME of the actuator's heartbeat that the server answers: the lease runs from there.
  int64_t echo_boottime_ns = 0;
  uint64_t term = 0;
  DecisionId decision_id;
  std::string level;
  uint32_t ttl_ms = 0;
  // See HeartbeatIntervalNs.
  uint32_t heartbeat_ms = 0;
  // Sensor live and backlog judged: a floor may lift.
  bool evidence_complete = false;
  // None: the server has no audit log.
  AuditHead audit_head;

  friend bool operator==(const LeaseGrant&, const LeaseGrant&) = default;
};

}  // namespace rips::model

#endif  // RIPS_SERVICES_MODEL_COMMAND_H_
