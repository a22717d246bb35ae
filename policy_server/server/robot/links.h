// How the pipeline speaks back to one attached agent. Implemented over gRPC streams and by fakes.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_LINKS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_LINKS_H_

#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "policy_server/policy/engine/interest/interest.h"
#include "policy_server/server/robot/model/inbound.h"
#include "policy_server/server/robot/model/outbound.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {

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
  virtual void Heartbeat(int64_t echo_boottime_ns) = 0;
  // What to watch from now on, and the topics of which the graph keeps the endpoints first. Returns
  // the id by which the sensor answers (InterestAnswer); one that has it in use already need not.
  virtual std::string SetInterest(const engine::InterestPlan& plan,
                                  const engine::PayloadLimits& limits,
                                  const ros2::TopicNames& kept_topics) = 0;
  // Ends the stream with this status.
  virtual void Close(const absl::Status& status) = 0;
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
