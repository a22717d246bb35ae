// What a sensor says of its findings, for tests: those that stand here are what it has told.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_TOLD_FINDINGS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_TOLD_FINDINGS_H_

#include "policy_server/server/robot/model/inbound.h"
#include "policy_server/server/robot/robot.h"
#include "services/model/finding_digest.h"

namespace rips::pipeline {

inline SensorStateSeen ToldFindings(const Robot& robot, bool all_told = true) {
  SensorStateSeen state{.findings_digest = 0, .findings_all_told = all_told};
  for (const FindingSeen& each : robot.core().findings().known().standing()) {
    *state.findings_digest += model::DigestOf(each);
  }
  return state;
}

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_TOLD_FINDINGS_H_
