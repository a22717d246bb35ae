// Whether an actuator may obey this server: what its hello is checked for, what the store is asked
// first, and terms that an administrator lets the server go above. Pure.
//
// Truth table of a hello that is admitted, by the decision that the actuator holds:
//   none                            it has no history; the newest decision goes out
//   in our history, same level      it is behind or even: the newest decision goes out
//   in our history, another level   our history is not the one it obeyed, as after a backup was
//                                   restored: the more restrictive level, as a new decision
//   unknown                         our history is incomplete: the same
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_ADMISSION_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_ADMISSION_H_

#include <cstdint>
#include <optional>
#include <string>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/server/robot/actuators/actuator_side.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/own_agents.h"
#include "policy_server/server/robot/decide/decider.h"
#include "policy_server/server/robot/decide/orders.h"
#include "policy_server/server/robot/decide/term_reset.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Admission {
 public:
  Admission(Context* context, engine::RobotState* state, Alerts* alerts, OwnAgents* own_agents,
            ActuatorSide* actuators, Decider* decider, Orders* orders)
      : context_(*context),
        state_(*state),
        alerts_(*alerts),
        own_agents_(*own_agents),
        actuators_(*actuators),
        decider_(*decider),
        orders_(*orders) {}

  // These three: the host whose session has begun; empty = none: the hello was refused, or waits
  // for the store.
  std::string OnHello(const input::ActuatorHello& in);
  std::string OnDecisionFound(const input::DecisionFound& in);
  std::string OnTermDrawn(const input::TermDrawn& in);
  // The stream of a hello that may still wait has ended.
  void OnGone(const std::string& host, SessionId session);
  // Goes above the term for which an actuator was refused, and decides the level anew.
  void OnResetTerm(const input::ResetTerm& in);
  // Closes hellos of hosts that are no longer listed.
  void CloseUnlisted();
  // Closes all hellos, and answers the orders that wait for a term.
  void CloseAll(const absl::Status& why);

 private:
  // What is remembered of a host that had a hello.
  struct Host {
    // Of a hello that waits for the store; 0 = none.
    SessionId arming = 0;
    // Of the hello that was refused last for it, until one is accepted.
    std::optional<ShownTerm> refused_term;
    // What an administrator let the server go above.
    std::optional<ShownTerm> pardoned_term;
  };
  // A hello that is acceptable, and what the store has said of it so far.
  struct Arming {
    input::ActuatorHello in;
    // Drawn above the term that the actuator has obeyed.
    std::optional<uint64_t> term;
    // The level of the decision that the hello names; the inner nullopt: no decision of ours.
    std::optional<std::optional<std::string>> level;
  };

  // Why the hello is refused.
  absl::Status Check(const input::ActuatorHello& in);
  // Asks the store for what must be known first, if anything, and arms the actuator.
  std::string GoOn(Arming arming);
  std::string OnAnswer(const absl::Status& status, Arming arming);
  void Reconcile(const input::ActuatorHello& in, const std::optional<std::string>& known);
  // What `order` is about; why it cannot be done.
  absl::StatusOr<ShownTerm> TermToReset(const TermResetOrder& order) const;
  absl::Status ResetTerm(const input::ResetTerm& in, const absl::StatusOr<uint64_t>& term);

  Context& context_;
  engine::RobotState& state_;
  Alerts& alerts_;
  OwnAgents& own_agents_;
  ActuatorSide& actuators_;
  Decider& decider_;
  Orders& orders_;
  absl::btree_map<std::string, Host> hosts_;
  // By question to the store.
  absl::btree_map<uint64_t, Arming> armings_;
  absl::btree_map<uint64_t, input::ResetTerm> resets_;
  uint64_t last_question_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_ADMISSION_H_
