// What one robot's rules and level machine decide, and what follows from it at once. Pure.
//
//   decision                               record   command
//   a raise                                at once  at once
//   a lowering, or a raise to below where  at once  when it is durable, and what a rule saw still
//   the robot was ordered while a                   holds; else it is taken back by a new, higher
//   lowering waits for the store                    decision
//   a refusal                              at 1, 2, 4, 8, ... of its kind; none
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_DECIDER_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_DECIDER_H_

#include <memory>
#include <string>
#include <utility>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/evaluator.h"
#include "policy_server/server/robot/actuators/actuator_side.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/durable_outbox.h"
#include "policy_server/server/robot/context/evidence_gate.h"
#include "policy_server/server/robot/decide/waiting_orders.h"

namespace rips::pipeline {

// What an event was made of, and what alerts add of it.
struct Source {
  const MessageSeen* message = nullptr;
  std::shared_ptr<const Batch> batch;
  std::string remark;
  // Only a policy that runs muted asked for it: the rules in force are not given it.
  bool muted = false;
};

// Not thread-safe. All that it is given outlives it.
class Decider {
 public:
  Decider(Context* context, engine::RobotState* state, Alerts* alerts, EvidenceGate* evidence,
          DurableOutbox* outbox, ActuatorSide* actuators)
      : context_(*context),
        state_(*state),
        alerts_(*alerts),
        evidence_(*evidence),
        outbox_(*outbox),
        actuators_(*actuators),
        budget_spent_(state->level.soft_suspended()) {}

  // Evaluates the rules on an event, and does what they ask for; a muted one is only recorded.
  // True: variables of the policy have changed.
  bool Run(const engine::Event& event, const Source& source = {});
  // The same with all of context.events, and those that these make.
  void RunEvents();
  void OnActuation(engine::Actuation actuation);
  void OnProgramResult(const ProgramResult& result);
  void Expire();

  // A decision, or a refusal, of the level machine. `late`: the event of a rule that was judged
  // long after it happened.
  void OnTransition(const engine::TransitionEffect& effect, const std::string& late = "");
  void Adopt(levels::LevelIndex level, const DecisionId& seen, const std::string& why);
  // An operator lets rules run again.
  void Resume();

  // The lowering is durable; evidence is up to date.
  void OnDurable(const levels::Transition& lowering);
  void TakeBack(const levels::Transition& lowering, engine::Severity severity, std::string why);
  // A lowering is neither commanded nor taken back.
  bool holds_back() const { return !outbox_.held_back().none(); }
  // Of operators; they wait for their decisions.
  WaitingOrders& orders() { return orders_; }

 private:
  void Perform(const engine::Outcome& outcome, const std::string& event,
               const std::string& late = "");
  void OnRefusal(const engine::TransitionEffect& effect);

  Context& context_;
  engine::RobotState& state_;
  Alerts& alerts_;
  EvidenceGate& evidence_;
  DurableOutbox& outbox_;
  ActuatorSide& actuators_;
  WaitingOrders orders_;
  // Reported, until an operator resumes the rules.
  bool budget_spent_;
  // Refusals already recorded: cause, from, to, reason → id.
  absl::btree_map<std::string, std::string> refusal_ids_;
};

std::string CauseText(const levels::Cause& cause);

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_DECIDER_H_
