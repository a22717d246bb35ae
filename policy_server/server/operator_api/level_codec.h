// A robot's levels and what became of orders about them, as operators see it.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_LEVEL_CODEC_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_LEVEL_CODEC_H_

#include "policy_server/server/robot/core/robot_core.h"
#include "policy_server/server/robot/model/level_order.h"
#include "policy_server/server/shard/agent_contacts.h"
#include "rips/v1/operator.pb.h"

namespace rips::operator_api {

// All but the status.
void Encode(const pipeline::LevelAnswer& answer, rips::v1::LevelResponse& out);
void Encode(const pipeline::LevelAnswer& answer, rips::v1::ResetTermResponse& out);
// All but the last transition.
void EncodeLevels(const pipeline::RobotCore& core, bool lowering_rules,
                  rips::v1::GetLevelResponse& out);
// Which agents the server knows at the addresses that its firewalls drop packets from.
void NameAgents(const pipeline::AgentContacts& contacts, rips::v1::GetLevelResponse& out);

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_LEVEL_CODEC_H_
