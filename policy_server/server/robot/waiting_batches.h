// What sensors sent and the robot has not judged yet.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_WAITING_BATCHES_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_WAITING_BATCHES_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "policy_server/policy/engine/evaluator.h"
#include "policy_server/server/robot/links.h"
#include "policy_server/server/robot/model/inbound.h"

namespace rips::pipeline {

// A message batch, how far it is judged, and the verdicts of its messages.
struct WaitingBatch {
  uint64_t ticket = 0;
  std::string host;
  std::shared_ptr<SensorLink> link;
  std::shared_ptr<const Batch> batch;
  int64_t arrived_ns = 0;
  // Observations before this one are judged.
  size_t judged = 0;
  // Under which it was asked.
  std::shared_ptr<const engine::CompiledPolicy> program;
  // By observation, then by index of the program's inspections; empty where none is needed.
  std::vector<std::vector<engine::Verdict>> verdicts;
  // Observations before this one have been looked at.
  size_t asked = 0;
  // Answers that have not come.
  size_t waiting = 0;
};

// A control batch, and how far it is judged.
struct ControlBatch {
  std::string host;
  std::shared_ptr<SensorLink> link;
  std::shared_ptr<const Batch> batch;
  // Observations before this one are judged.
  size_t judged = 0;
  // Graphs that were judged, each by an event of its own.
  size_t graphs = 0;
  // Of the newest graph, which is taken and not judged yet.
  std::optional<engine::Event> merged;
};

// Control batches in the order they came; only the first is being judged.
struct ControlLine {
  std::deque<ControlBatch> batches;
  // What agents sent waits for its turn for too long.
  bool backlog = false;
};

// Message batches in the order they came; only the first is being judged.
struct MessageLine {
  std::deque<WaitingBatch> batches;
  uint64_t last_ticket = 0;
  bool advancing = false;
  // A turn was over before all that can be judged was.
  bool unfinished = false;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_WAITING_BATCHES_H_
