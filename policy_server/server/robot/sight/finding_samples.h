// Findings as a sensor tells them, for tests. Header only.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_SAMPLES_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_SAMPLES_H_

#include <cstdint>
#include <string>

#include "policy_server/server/robot/model/inbound.h"

namespace rips::pipeline {

inline FindingSeen Impostor(uint8_t number, const std::string& node = "/rips") {
  FindingSeen seen{.kind = "impostor", .node = node, .detail = "why"};
  seen.guid.bytes[11] = number;
  return seen;
}
inline FindingSeen Over(FindingSeen seen) {
  seen.over = true;
  return seen;
}

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_SAMPLES_H_
