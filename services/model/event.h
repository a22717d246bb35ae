// Event: what `rules External` are evaluated on, besides messages and graph changes
// (policy_server/policy/engine/state/event.h).
#ifndef RIPS_SERVICES_MODEL_EVENT_H_
#define RIPS_SERVICES_MODEL_EVENT_H_

#include <string>
#include <variant>

#include "services/model/observation.h"

namespace rips::model {

// A state change of one of the robot's agents, in the words of the rule language.
struct AgentEvent {
  // sensor | actuator
  std::string agent;
  // connected | lost | restarting | drift | failed | state_lost | ...
  std::string state;

  friend bool operator==(const AgentEvent&, const AgentEvent&) = default;
};

struct TickEvent {
  friend bool operator==(const TickEvent&, const TickEvent&) = default;
};

using ExternalEvent = std::variant<IdsAlert, SignalSeen, AgentEvent, Finding, Loss, TickEvent>;

}  // namespace rips::model

#endif  // RIPS_SERVICES_MODEL_EVENT_H_
