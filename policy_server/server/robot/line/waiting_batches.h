// What a sensor sent and the robot has not judged yet.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_WAITING_BATCHES_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_WAITING_BATCHES_H_

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "absl/types/span.h"
#include "policy_server/policy/engine/state/verdict.h"
#include "policy_server/server/robot/context/input.h"
#include "policy_server/server/robot/model/inbound.h"

namespace rips::pipeline {

// A batch of one session, and how far it is judged.
struct WaitingBatch {
  std::string host;
  SessionId session = 0;
  std::shared_ptr<const Batch> batch;
  // Observations before this one are judged.
  size_t judged = 0;

  bool whole() const { return judged == batch->observations.size(); }
};

// Of a waiting batch: the observations [from, to), which are judged now, without a break.
struct Piece {
  const WaitingBatch& waiting;
  size_t from = 0;
  size_t to = 0;
  // By observation of the batch, then by index of the program's inspections; empty where none is
  // needed. May be shorter than the batch.
  absl::Span<const std::vector<engine::Verdict>> verdicts;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_WAITING_BATCHES_H_
