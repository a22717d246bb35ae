// How the pipeline speaks back to one attached agent. Implemented over gRPC streams and by fakes.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_LINKS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_LINKS_H_

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "policy_server/policy/engine/interest/interest.h"
#include "policy_server/server/robot/inbound.h"
#include "policy_server/server/store/generations.h"
#include "services/base/mark.h"
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

// Any thread; never blocks. Calls after the stream has ended do nothing.
class SensorLink {
 public:
  virtual ~SensorLink() = default;
  virtual void Setup(const SensorSetup& setup) = 0;
  // `commit`: of the store's generation, which has it all.
  virtual void Acknowledge(const std::string& incarnation, Lane lane, uint64_t sequence,
                           uint64_t commit) = 0;
  // Cumulative since stream start: bytes of message batches, and of payloads that come in chunks.
  virtual void Grant(uint64_t message_bytes, uint64_t payload_bytes) = 0;
  // `echo_boottime_ns`: the peer's newest.
  virtual void Beat(int64_t echo_boottime_ns) = 0;
  // What to watch from now on, and the topics of which the graph keeps the endpoints first. Returns
  // the id by which the sensor answers (InterestAnswer); one that has it in use already need not.
  virtual std::string SetInterest(const engine::InterestPlan& plan,
                                  const engine::PayloadLimits& limits,
                                  const ros2::TopicNames& kept_topics) = 0;
  // Ends the stream with this status.
  virtual void Close(const absl::Status& status) = 0;
};

struct LeaseGrant {
  int64_t echo_boottime_ns = 0;
  uint64_t term = 0;
  Mark mark;
  std::string level;
  uint32_t ttl_ms = 0;
  bool evidence_complete = false;
};

struct SetLevel {
  Mark mark;
  std::string from;
  std::string to;
  std::string cause;
  // None unless `to` is below what the actuator holds.
  Mark based_on;

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

// Any thread; never blocks. Calls after the stream has ended do nothing.
class ActuatorLink {
 public:
  virtual ~ActuatorLink() = default;
  virtual void Grant(const LeaseGrant& lease) = 0;
  virtual void Send(const Command& command) = 0;
  virtual void Close(const absl::Status& status) = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_LINKS_H_
