// What actuators say: services/model.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ACTUATOR_INBOUND_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ACTUATOR_INBOUND_H_

#include "services/model/receipt.h"

namespace rips::pipeline {

using model::ActuatorHeartbeat;
using model::ActuatorHello;
using model::Drilled;
using model::Receipt;
using model::StepResult;

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ACTUATOR_INBOUND_H_
