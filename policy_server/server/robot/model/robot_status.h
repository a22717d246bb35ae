// One robot as an operator sees it.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ROBOT_STATUS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ROBOT_STATUS_H_

#include <string>
#include <vector>

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

  friend bool operator==(const RobotStatus&, const RobotStatus&) = default;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ROBOT_STATUS_H_
