// What RIPS's own agents of one robot are on its bus, and whether another process uses the key of
// one. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_OWN_AGENTS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_OWN_AGENTS_H_

#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/own_participants.h"
#include "policy_server/server/robot/context/second_holder.h"
#include "services/ros2/guid.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it. `agent` is `sensor HOST` or `actuator HOST`.
class OwnAgents {
 public:
  OwnAgents(Context* context, Alerts* alerts, const engine::CurrentGraph* graph)
      : context_(*context), alerts_(*alerts), graph_(*graph) {}

  // The agent says that this participant is its own; none() = it does not say.
  void AddParticipant(const std::string& agent, const ros2::Guid& participant);
  // True if a participant was given up.
  bool Expire();
  void Forget(const std::string& agent) { agents_.erase(agent); }
  // Of all agents: of actuators first, by host.
  std::vector<ros2::Guid> participants() const;

  // Full names of the parts whose modes this actuator sets.
  void SetParts(const std::string& agent, std::vector<std::string> parts);
  bool HasParts(const std::string& agent) const;
  // Of all actuators, sorted.
  std::vector<std::string> parts() const;

  // `peer`: the transport's address. A session begins; is refused, since there is a live one; is
  // heard.
  void OnSession(const std::string& agent, const std::string& peer);
  void OnRefused(const std::string& agent, const std::string& peer);
  void OnHeard(const std::string& agent);
  // Its key was used for what no agent does.
  void OnMisused(const std::string& agent, const std::string& peer);
  // Why what its session says may be another process's; empty = nothing speaks for that.
  std::string DoubtOf(const std::string& agent) const;

 private:
  struct Agent {
    OwnParticipants participants;
    std::vector<std::string> parts;
    SecondHolder second;
  };
  // `sensor ROBOT/HOST`.
  std::string FullName(const std::string& agent) const;

  Context& context_;
  Alerts& alerts_;
  const engine::CurrentGraph& graph_;
  absl::btree_map<std::string, Agent> agents_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_OWN_AGENTS_H_
