// One robot as an operator sees it.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ROBOT_STATUS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ROBOT_STATUS_H_

#include <optional>
#include <string>
#include <vector>

#include "policy_server/server/robot/model/level_order.h"
#include "policy_server/server/store/maintenance.h"
#include "services/base/decision_id.h"

namespace rips::pipeline {

struct RobotStatus {
  std::string robot;
  std::string decided_level;
  // The most restrictive any attached actuator reports; empty = none attached.
  std::string effective_level;
  std::string stage;
  DecisionId decision_id;
  std::string bundle_version;
  std::vector<std::string> degraded;
  // Lowerings that wait for a second operator, oldest first.
  std::vector<PendingApproval> pending_approvals;
  // Why it is not judged by the bundle that it should be; one of `degraded`, or empty.
  std::string policy_problem;
  // All of its sensors are connected, and were heard lately.
  bool watched = false;
  // That holds now, if any.
  std::optional<store::Maintenance> maintenance = std::nullopt;

  friend bool operator==(const RobotStatus&, const RobotStatus&) = default;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ROBOT_STATUS_H_
