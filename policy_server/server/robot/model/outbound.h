// What a robot's agents are sent: inbound.h and actuator_inbound.h the other way round.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_OUTBOUND_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_OUTBOUND_H_

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "policy_server/server/store/generations.h"
#include "services/base/decision_id.h"
#include "services/ros2/guid.h"

namespace rips::pipeline {

struct SensorSetup {
  uint32_t linger_ms = 20;
  uint32_t batch_observations = 128;
  uint32_t batch_bytes = 32 * 1024;
  std::vector<ros2::Guid> own_participants;
  // Full names.
  std::vector<std::string> protected_parts;
  bool primary = false;
  // The server holds no graph of this incarnation: send a snapshot.
  bool want_snapshot = true;
  // What the store holds, for its next hello.
  store::StorePoint store;
};

struct LeaseGrant {
  int64_t echo_boottime_ns = 0;
  uint64_t term = 0;
  DecisionId decision_id;
  std::string level;
  uint32_t ttl_ms = 0;
  bool evidence_complete = false;
};

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
  uint32_t timeout_ms = 0;

  friend bool operator==(const RunProgram&, const RunProgram&) = default;
};

// Tries what `level` does without doing it.
struct Drill {
  std::string level;

  friend bool operator==(const Drill&, const Drill&) = default;
};

struct Command {
  // 32 hex digits.
  std::string id;
  uint64_t term = 0;
  uint32_t ttl_ms = 0;
  std::variant<SetLevel, RunProgram, Drill> what;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_OUTBOUND_H_
