// What a robot's agents are sent: inbound.h and actuator_inbound.h the other way round.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_OUTBOUND_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_OUTBOUND_H_

#include <cstdint>
#include <string>
#include <vector>

#include "policy_server/server/store/generations.h"
#include "services/base/config_setting.h"
#include "services/model/command.h"
#include "services/ros2/guid.h"

namespace rips::pipeline {

using model::Command;
using model::Drill;
using model::LeaseGrant;
using model::RunProgram;
using model::SetLevel;

struct SensorSetup {
  uint32_t linger_ms = 20;
  uint32_t heartbeat_ms = 500;
  uint32_t batch_observations = 128;
  uint32_t batch_bytes = 32 * 1024;
  std::vector<ros2::Guid> own_participants;
  // Full names.
  std::vector<std::string> protected_parts;
  bool primary = false;
  // The server holds no graph of this incarnation: send a snapshot.
  bool want_snapshot = true;
  // To be told again all findings that stand.
  bool want_findings = false;
  // See RobotConfig.
  std::vector<ConfigSetting> settings;
  // What the store holds, for its next hello.
  store::StorePoint store;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_OUTBOUND_H_
