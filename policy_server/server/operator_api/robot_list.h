// The answer of ListRobots, put together from what robots, inventory and agents' streams give.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ROBOT_LIST_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ROBOT_LIST_H_

#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "policy_server/server/shard/agent_contacts.h"
#include "policy_server/server/shard/robot_labels.h"
#include "rips/v1/operator.pb.h"

namespace rips::operator_api {

// What is known of robots without asking them. Not owned; null: nothing is.
struct RobotListSources {
  const pipeline::AgentContacts* contacts = nullptr;
  const pipeline::RobotLabels* labels = nullptr;
};

// Fills `response` with those robots that `request` wants, with their agents. `statuses` by robot,
// `silent` sorted. Not yet cut to a length: FitStatuses.
void FillRobotList(const rips::v1::ListRobotsRequest& request, const RobotListSources& sources,
                   absl::btree_map<std::string, rips::v1::RobotStatus> statuses,
                   const std::vector<std::string>& silent, rips::v1::ListRobotsResponse& response);

// What each agent of the robot that the inventory lists said of its configuration.
void FillAgentConfigurations(const pipeline::AgentContacts& contacts, const std::string& robot,
                             rips::v1::GetConfigurationResponse& response);

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ROBOT_LIST_H_
