// What operators order of one robot's level. Each order is answered once: when its decision is
// durable, or at once if there is none. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_ORDERS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_ORDERS_H_

#include <cstdint>
#include <string>
#include <utility>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/durable_outbox.h"
#include "policy_server/server/robot/decide/approvals.h"
#include "policy_server/server/robot/decide/decider.h"
#include "policy_server/server/robot/decide/evidence.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Orders {
 public:
  Orders(Context* context, engine::RobotState* state, Alerts* alerts, DurableOutbox* outbox,
         Decider* decider, const Evidence* evidence)
      : context_(*context),
        state_(*state),
        alerts_(*alerts),
        outbox_(*outbox),
        decider_(*decider),
        evidence_(*evidence),
        approvals_(context, state, alerts) {}

  void OnRaise(const input::Raise& in);
  // Waits for a second operator if one of the levels that it would leave says so.
  void OnDeEscalate(const input::DeEscalate& in);
  // The second operator's: everything is checked anew.
  void OnApprove(const input::Approve& in);
  // A record of an order that its sender had no right to: among the refused transitions, once for
  // each operator and level, with a count. Not of a level that the robot does not have.
  void OnRefused(const input::RefusedOrder& in);
  // Rules may lower soft levels again, and run again after a `crash`.
  void OnResume(const input::ResumeRules& in);
  // The rules judge it now, before what sensors have sent and waits.
  void OnSignal(const input::SendSignal& in);
  // An operator's transition, which is in force: answered when it is durable.
  void Decide(const levels::Transition& transition, const LevelOrder& order,
              action::AnswerOrder answer);
  void RefuseAll(const absl::Status& why);
  // Lowerings that wait for a second operator.
  Approvals& approvals() { return approvals_; }
  const Approvals& approvals() const { return approvals_; }
  // InvalidArgument unless the reason has 1 to kReasonBytesMax bytes.
  static absl::Status CheckReason(const std::string& reason);

 private:
  // True if it was answered: it repeats another order, or the server is stopping.
  bool AnsweredAlready(const LevelOrder& order, ReplyToken token);
  // An alert of a change by hand, for those who watch alerts elsewhere: high if it lowers the robot
  // while RIPS does not see all of it, medium if it lowers it, low if it raises it.
  void ReportChange(const levels::Transition& transition, const LevelOrder& order,
                    const LevelAnswer& answer);
  // Of one that CheckLowering found in order.
  levels::Transition Lower(const LevelOrder& order, levels::LevelMachine& machine) const;
  // Whether a lowering can be considered, and what `answer` says of it.
  absl::Status CheckLowering(const LevelOrder& order, LevelAnswer& answer) const;
  const levels::LevelTable& levels() const { return state_.level.table(); }

  Context& context_;
  engine::RobotState& state_;
  Alerts& alerts_;
  DurableOutbox& outbox_;
  Decider& decider_;
  const Evidence& evidence_;
  Approvals approvals_;
  // By operator and level: the id of the record, and the count.
  absl::btree_map<std::string, std::pair<std::string, uint64_t>> refused_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_ORDERS_H_
