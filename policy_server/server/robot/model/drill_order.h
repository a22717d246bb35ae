// A drill that an operator asks for, and what it came to.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_DRILL_ORDER_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_DRILL_ORDER_H_

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "policy_server/server/robot/model/actuator_inbound.h"

namespace rips::pipeline {

struct DrillOrder {
  std::string operator_name;
  // Empty = every level.
  std::string level;
};

struct DrillEntry {
  std::string level;
  std::string host;
  // None: no answer.
  std::optional<Receipt::Stage> stage;
  std::vector<StepResult> steps;
  // Human-readable and printable.
  std::string detail;
};

struct DrillAnswer {
  absl::Status status;
  // By level in order, then by host.
  std::vector<DrillEntry> drills;
};
// Called once, on the shard's thread.
using DrillReply = std::function<void(const DrillAnswer&)>;

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_DRILL_ORDER_H_
