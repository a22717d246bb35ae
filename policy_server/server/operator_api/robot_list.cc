#include "policy_server/server/operator_api/robot_list.h"

#include <cstdint>
#include <utility>

#include "services/runtime/daemon_flags.h"

namespace rips::operator_api {
namespace {

const char* RoleName(pipeline::AgentKind kind) {
  return kind == pipeline::AgentKind::kSensor ? "sensor" : "actuator";
}

void AddAgents(const std::vector<pipeline::AgentContacts::Contact>& contacts,
               rips::v1::RobotStatus& status) {
  for (const pipeline::AgentContacts::Contact& contact : contacts) {
    rips::v1::AgentContact* agent = status.add_agents();
    agent->set_role(RoleName(contact.agent.kind));
    agent->set_host(contact.agent.host);
    agent->set_version(contact.version);
    agent->set_heard_unix_ns(contact.heard_unix_ns);
    agent->set_heard_ago_ms(static_cast<uint64_t>(contact.heard_ago_ns / kNanosPerMilli));
  }
}

}  // namespace

void FillRobotList(const rips::v1::ListRobotsRequest& request, const RobotListSources& sources,
                   absl::btree_map<std::string, rips::v1::RobotStatus> statuses,
                   const std::vector<std::string>& silent, rips::v1::ListRobotsResponse& response) {
  const auto wanted = [&](const std::string& robot) {
    return sources.labels == nullptr ? request.labels().empty()
                                     : sources.labels->HasAll(robot, request.labels());
  };
  response.set_server_version(std::string(RipsVersion()));
  for (auto& [robot, status] : statuses) {
    if (!wanted(robot)) continue;
    if (sources.contacts != nullptr) AddAgents(sources.contacts->Of(robot), status);
    *response.add_robots() = std::move(status);
  }
  for (const std::string& robot : silent) {
    if (wanted(robot)) response.add_no_answer(robot);
  }
}

void FillAgentConfigurations(const pipeline::AgentContacts& contacts, const std::string& robot,
                             rips::v1::GetConfigurationResponse& response) {
  absl::btree_map<pipeline::AgentId, pipeline::AgentContacts::Said> said;
  for (pipeline::AgentContacts::Said& each : contacts.ConfigurationsOf(robot)) {
    said.emplace(each.agent, std::move(each));
  }
  for (const pipeline::AgentContacts::Contact& contact : contacts.Of(robot)) {
    rips::v1::AgentConfiguration* const added = response.add_agents();
    added->set_role(RoleName(contact.agent.kind));
    added->set_host(contact.agent.host);
    const auto found = said.find(contact.agent);
    if (found == said.end()) continue;
    *added->mutable_configuration() = std::move(found->second.configuration);
    added->set_said_unix_ns(found->second.unix_ns);
  }
}

}  // namespace rips::operator_api
