// The core of one robot: everything it is, and everything that follows from what happens to it.
// Pure: it knows no port, clock, thread or callback. One thread.
//
// Invariants kept here:
//   - The level goes down only by a soft rule step with complete evidence, or by an operator.
//   - What an agent says of itself grants nothing: host and role come from its certificate.
//
// The order of actions is part of the contract, within one On and from one to the next:
//
//   action                              comes
//   SendCommand of a raise              at once, before the Record of its decision
//   SendCommand of a lowering           after Recorded(ok) of its decision, if its evidence holds;
//                                       else a new, higher decision is commanded
//   Acknowledge                         after Recorded(ok) of all effects of what it acknowledges
//   AnswerOrder of a decision           after Recorded(ok), or RaisesSaved
//   Record                              one at a time; the next after its Recorded
//   alerts to observers                 by the shell, when their Record is durable
//   Close of a session                  nothing to it comes after it
//   ReportRetired                       once, before the Close of all sessions; nothing is
//                                       commanded any more, nor recorded if it was Aborted
//   PublishStatus                       after all else, and only when the status has changed
//
// Each On ends with the same epilogue, whatever the input was:
//
//   events that parts have seen are judged; the stage of the newest decision is recorded, evidence
//   is brought up to date, chains that wait for it go on; commands that are due are sent; what is
//   collected is recorded; the status is published
//
//   input                               recorded                     published
//   Advance, SensorBatch, heartbeats,   if the last write succeeded  at the next heartbeat of the
//   Receipt, Inspected, InterestSent                                 server
//   Time                                the same, or once a second   each heartbeat of the server
//   Recorded                            if it succeeded              yes
//   all others                          yes                          yes
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CORE_ROBOT_CORE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CORE_ROBOT_CORE_H_

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/foresight.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/server/robot/actuators/actuator_side.h"
#include "policy_server/server/robot/actuators/drills.h"
#include "policy_server/server/robot/context/action.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/durable_outbox.h"
#include "policy_server/server/robot/context/evidence_gate.h"
#include "policy_server/server/robot/context/input.h"
#include "policy_server/server/robot/context/maintenance_window.h"
#include "policy_server/server/robot/context/own_agents.h"
#include "policy_server/server/robot/core/judge.h"
#include "policy_server/server/robot/decide/admission.h"
#include "policy_server/server/robot/decide/decider.h"
#include "policy_server/server/robot/decide/evidence.h"
#include "policy_server/server/robot/decide/maintenance_orders.h"
#include "policy_server/server/robot/decide/orders.h"
#include "policy_server/server/robot/model/judged_event.h"
#include "policy_server/server/robot/sensors/losses.h"
#include "policy_server/server/robot/sensors/sensor_side.h"
#include "policy_server/server/robot/sight/findings.h"
#include "policy_server/server/robot/sight/sight.h"
#include "policy_server/server/store/records.h"

namespace rips::pipeline {

// What a core begins with.
struct CoreStart {
  RobotConfig config;
  Policy policy;
  Timing timing;
  // What the store knows of the robot, and by when.
  store::RobotRecord record;
  store::StorePoint store;
  // Drawn by the store when this server acquired the robot: the first term, and the fence of all
  // that is recorded.
  uint64_t tenure = 0;
  // As of IdSource.
  std::string id_seed;
  Moment moment;
};

class RobotCore {
 public:
  // InvalidArgument if the recorded level is not one of the policy's.
  static absl::StatusOr<std::unique_ptr<RobotCore>> Create(CoreStart start);

  // Judges one input. The caller performs the actions, in order, before the next.
  Actions On(const Input& input, const Moment& moment);
  // Gives performed actions back, so that their memory is used again.
  void Recycle(Actions actions);

  // There is more to Advance: of control, of messages. Each On judges at most one piece.
  bool has_control() const { return judge_.has_control(); }
  bool has_messages() const { return judge_.has_messages(); }
  // Retired, and everything it decided is durable, or will never be.
  bool gone() const { return !retired_.ok() && outbox_.done(); }

  // What is known as of `moment`: to be asked before the next On.
  const RobotCore& At(const Moment& moment) {
    context_.moment = moment;
    return *this;
  }
  RobotStatus Status() const;
  // As rules judge the next event.
  RulesState rules() const;
  const std::string& id() const { return context_.config.id; }
  const Policy& policy() const { return context_.policy; }
  const Watch& watch() const { return context_.watch; }
  const levels::LevelTable& levels() const { return state_.level.table(); }
  // What is in the way of a rule that asks for the next less restrictive level, besides its own
  // condition; empty = nothing, unset at the lowest level.
  std::optional<std::string> WhyRulesCannotLower() const;
  // Rules that ask for that level, and whether they would now.
  std::vector<engine::LoweringRule> LoweringRules() const {
    return engine::LoweringRules(context_.now(), state_);
  }
  // In force.
  const ros2::RosGraph& graph() const { return state_.graph.get(); }
  const GraphHistory::Version& graph_version() const { return state_.graph.version(); }
  const Judge& judge() const { return judge_; }
  const Sight& sight() const { return sight_; }
  const Losses& losses() const { return losses_; }
  const Findings& findings() const { return findings_; }
  const ActuatorSide& actuators() const { return actuators_; }
  const DurableOutbox& outbox() const { return outbox_; }

 private:
  // What the epilogue does beside what it always does.
  enum class After { kRoutine, kPublish, kFlush, kFlushAndPublish };

  RobotCore(CoreStart start, levels::LevelMachine level);

  After Handle(const Input& input);
  After OnSensorHello(const input::SensorHello& in);
  After OnArmed(const std::string& host);
  After OnReceipt(const input::Receipt& in);
  After OnRecorded(const input::Recorded& in);
  After OnTime();
  void OnTick();
  void OnSwapPolicy(const input::SwapPolicy& in);
  void OnSetHosts(const input::SetHosts& in);
  void OnDrain();
  void OnRetire(const absl::Status& why);
  void OnDurable(const DecisionId& decision_id);

  void Epilogue(After after);
  // Whether what is read back may be forged, by the findings that stand.
  void UpdateDoubt();
  void UpdateActuation();
  void Flush();

  Context context_;
  engine::RobotState state_;
  EvidenceGate gate_;
  DurableOutbox outbox_;
  MaintenanceWindow window_;
  Alerts alerts_;
  OwnAgents own_agents_;
  Losses losses_;
  SensorSide sensors_;
  Sight sight_;
  Findings findings_;
  ActuatorSide actuators_;
  Drills drills_;
  MaintenanceOrders maintenance_;
  Evidence evidence_;
  Decider decider_;
  Orders orders_;
  Admission admission_;
  Judge judge_;
  // Why, once it has retired.
  absl::Status retired_;
  // Why the bundle that the inventory names is not the one in force; empty = it is.
  std::string policy_problem_;
  // CLOCK_BOOTTIME.
  int64_t next_heartbeat_ns_ = 0;
  int64_t next_tick_ns_ = 0;
  int64_t next_checkpoint_ns_ = 0;
  RobotStatus published_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CORE_ROBOT_CORE_H_
