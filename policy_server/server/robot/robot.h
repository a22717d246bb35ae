// One robot on the server: everything it is and everything that happens to it, in one thread.
//
// Observations come in, events are judged, effects are recorded and sent. Invariants kept here:
//   - The level goes down only by a soft rule step with complete evidence, or by an operator.
//   - A raise is commanded at once while it is being recorded; a lowering is commanded only when it
//     is durable, and taken back (as a new, higher decision) if it cannot be recorded.
//   - An observation is acknowledged only when its effects and its sequence number are durable.
//   - What an agent says of itself grants nothing: host and role come from its certificate.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_H_

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <source_location>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/types/span.h"
#include "policy_server/policy/engine/evaluator.h"
#include "policy_server/server/robot/model/robot_config.h"
#include "policy_server/server/robot/parts/alert_limiter.h"
#include "policy_server/server/robot/parts/command_reconciler.h"
#include "policy_server/server/robot/parts/durable_outbox.h"
#include "policy_server/server/robot/parts/evidence_gate.h"
#include "policy_server/server/robot/parts/finding_registry.h"
#include "policy_server/server/robot/parts/graph_history.h"
#include "policy_server/server/robot/parts/loss_alarm.h"
#include "policy_server/server/robot/parts/receipt_history.h"
#include "policy_server/server/robot/parts/waiting_orders.h"
#include "policy_server/server/robot/policy.h"
#include "policy_server/server/robot/ports.h"
#include "policy_server/server/robot/robot_hosts.h"
#include "policy_server/server/store/store.h"
#include "services/base/clock.h"

namespace rips::pipeline {

// Not thread-safe: one shard owns it and calls everything. Ports outlive it.
class Robot {
 public:
  // `record` is what the store knows; `term` was drawn for this start. InvalidArgument if the
  // recorded level is not one of the policy's.
  static absl::StatusOr<std::unique_ptr<Robot>> Create(RobotConfig config, Policy policy,
                                                       Timing timing,
                                                       const store::RobotRecord& record,
                                                       uint64_t term, Ports ports);

  // ---- sensors; `link` names the session, calls of replaced sessions are ignored.
  void OnSensorHello(const std::string& host, std::shared_ptr<SensorLink> link,
                     const SensorHello& hello);
  void OnSensorHeartbeat(const std::string& host, const SensorLink* link,
                         const SensorHeartbeat& heartbeat);
  void OnInterestAnswer(const std::string& host, const SensorLink* link,
                        const InterestAnswer& answer);
  // Control batches are judged at once, for a turn (robot_control.cc): while HasControl, Advance
  // comes before other control, while HasMessages, before other messages. A message waits for those
  // before it, for its inspections, and for the graph that it names (robot_messages.cc).
  void OnBatch(const std::string& host, const SensorLink* link, std::shared_ptr<const Batch> batch);
  bool HasControl() const { return !control_line_.batches.empty(); }
  bool HasMessages() const { return message_line_.unfinished; }
  void Advance();
  void OnSensorGone(const std::string& host, const SensorLink* link);

  // ---- actuators
  void OnActuatorHello(const std::string& host, std::shared_ptr<ActuatorLink> link,
                       const ActuatorHello& hello);
  void OnActuatorHeartbeat(const std::string& host, const ActuatorLink* link,
                           const ActuatorHeartbeat& heartbeat);
  void OnReceipt(const std::string& host, const ActuatorLink* link, const Receipt& receipt);
  void OnActuatorGone(const std::string& host, const ActuatorLink* link);

  // ---- operators; `reply` is called once, later, on the shard's thread.
  void Raise(const LevelOrder& order, LevelReply reply);
  void DeEscalate(const LevelOrder& order, LevelReply reply);
  // Goes above the term for which an actuator was refused, and decides the level anew.
  void ResetTerm(const TermResetOrder& order, LevelReply reply);
  // Rules may lower soft levels again, and run again after a `crash`.
  absl::Status ResumeRules(const std::string& operator_name, const std::string& reason);
  // A record of an order that its sender had no right to: among the refused transitions, once for
  // each operator and level, with a count. Not of a level that the robot does not have.
  void RecordRefusedOrder(const LevelOrder& order, const absl::Status& why);
  // RIPS's own alert of what others found out about its agents; each caller is a kind (OwnAlert).
  void Report(engine::Severity severity, const std::string& text,
              std::source_location where = std::source_location::current());
  // Answered when each actuator has, or after kDrillAnswerNs. InvalidArgument for no level of the
  // robot, FailedPrecondition if no actuator is attached or another drill is under way.
  void StartDrill(const DrillOrder& order, DrillReply reply);
  const ReceiptHistory& receipts() const { return receipts_; }  // since the start
  RobotStatus Status() const;
  // Tells the tap every event, before it is judged. ResourceExhausted past kTapsMax.
  static constexpr size_t kTapsMax = 4;
  absl::Status AddTap(std::shared_ptr<EventRecorder> tap);
  const ros2::RosGraph& graph() const { return state_.graph.get(); }
  const GraphHistory::Version& graph_version() const { return state_.graph.version(); }
  std::vector<FindingSeen> findings() const { return findings_.standing(); }  // oldest first
  int64_t graph_changed_unix_ns() const { return graph_changed_unix_ns_; }
  const levels::LevelTable& levels() const { return state_.level.table(); }
  // What the rules in force need of each topic.
  const engine::InterestPlan& interest() const { return *interest_; }
  const ros2::TopicNames& kept_topics() const { return *kept_topics_; }
  std::vector<SensorInterest> SensorInterests() const;  // of sensors that report messages
  std::vector<SensorCoverage> Coverage() const;         // of every sensor host, sorted
  // Inspections that were not made in the last ten minutes, by reason.
  absl::btree_map<std::string, uint64_t> Skipped() const;
  // Why the robot, or an input that a sensor was told to watch, is not seen; printable.
  const std::vector<std::string>& blind() const { return sight_.blind; }
  const engine::PayloadLimits& payload_limits() const { return policy_.payload_limits; }
  // Alerts that the store has not taken yet, oldest first.
  const std::vector<store::AlertRecord>& unrecorded_alerts() const { return outbox_.alerts(); }
  // Topics of which payloads were cut lately.
  std::vector<CutPayloads::Topic> CutTopics() const;

  // ---- time; call at least every 50 ms. What agents sent waits for its turn for too long, or not.
  void SetBacklog(bool backlog) { control_line_.backlog = backlog; }
  void OnTime();
  // Another bundle, between two events. FailedPrecondition: the old one stays, with an alert.
  absl::Status SwapPolicy(Policy policy);
  // Leases from now on last drain_lease: the server is about to stop.
  void Drain();

  // ---- inventory (robot_inventory.cc)
  // Other hosts, or another primary sensor, are listed from now on. Sessions of hosts that are no
  // longer listed, or whose part has changed, are ended with words. `config.id` is this robot's.
  void SetHosts(const RobotConfig& config);
  // Why the bundle that the inventory names is not the one in force; empty = it is.
  void SetPolicyProblem(std::string problem);
  // No longer listed: ends its sessions with `why`, answers who waits, and records what is left.
  // Afterwards only OnTime is called, until gone().
  void Retire(const absl::Status& why);
  // Retired, and everything it decided is durable.
  bool gone() const;

  const std::string& id() const { return config_.id; }

 private:
  Robot(RobotConfig config, Policy policy, Timing timing, const store::RobotRecord& record,
        levels::LevelMachine level, Ports ports);

  // robot_control.cc
  void AdvanceControl();
  bool MergesGraph(const Batch& batch, const engine::Event& event, int64_t boottime_ns);
  void JudgeMerged(ControlBatch& batch);
  // robot_messages.cc
  void AdvanceMessages();
  // Asks for inspections as far as messages know their graph. How many observations can be judged.
  size_t AskInspections(WaitingBatch& batch);
  void AskInspection(WaitingBatch& batch, size_t index, std::vector<uint32_t> needed);
  // Against which graph the message is judged.
  GraphHistory::Choice ChooseGraph(const SensorHost& host, const Batch& batch,
                                   const MessageSeen& message) const;
  // True when the message has a graph, or has waited for one long enough.
  bool KnowsGraph(const WaitingBatch& batch, const MessageSeen& message);
  void JudgeMessage(SensorHost& host, const Batch& batch, const MessageSeen& message,
                    engine::Event event, absl::Span<const engine::Verdict> inspections);
  void OnInspected(uint64_t ticket, size_t index, const std::vector<uint32_t>& asked,
                   const std::vector<engine::Verdict>& verdicts);

  // robot_coverage.cc
  void UseInterest();  // that of the policy in force
  bool AskInterest(SensorSession& session);
  // Empty if it watches what the rules need.
  std::string InterestProblem(const SensorHost& host) const;
  void TakeHello(SensorHost& host, const SensorHello& hello, Instant now);
  // True if the sensor is overloaded now and was not before. `boottime_ns` is the sensor's.
  bool TakeState(SensorHost& host, SensorStateSeen state, int64_t boottime_ns);
  void CountLost(SensorHost& host, uint64_t count);
  void CountCut(const MessageSeen& message);
  void UpdateCoverage(Instant now);

  // robot_blind.cc
  // What is not seen now. Call it when the graph, the parts of actuators or what a sensor says of
  // its inputs may have changed, before the evidence is asked for.
  void UpdateBlind(Instant now);
  void TellBlind(Instant now);
  void TellTruncated(Instant now);
  // What was left out here stays so; when there is room again, the sensor sends the graph anew.
  void RecoverTruncated(Instant now);
  // Of the primary sensor's graph; no problem while there is none.
  void ExamineOwnGraph();
  // An actuator has read back, from the parts whose modes it sets, that they are where they must
  // be.
  bool PartsVerified(Instant now) const;

  // robot_sensors.cc
  // Null if `link` is not the session's.
  SensorSession* SessionOf(const std::string& host, const SensorLink* link);
  // The same, for what has just come from the sensor: it lives.
  SensorSession* HearSensor(const std::string& host, const SensorLink* link);
  // The observations [from, to) of the batch. `verdicts` as in WaitingBatch; may be empty.
  void JudgeBatch(const std::string& host, const SensorLink* link, const Batch& batch, size_t from,
                  size_t to, const std::vector<std::vector<engine::Verdict>>& verdicts);
  // Numbers that a sensor gave and that will not come: counted here, once. Its own Loss records
  // tell of what never had a number.
  void Missing(SensorHost& host, uint64_t count);
  void Judge(SensorHost& host, SensorSession& session, bool primary, const Batch& batch,
             size_t index, absl::Span<const engine::Verdict> inspections);
  // Of a snapshot or a delta: takes it, and judges the graph unless it is merged with the next.
  void JudgeGraph(SensorHost& host, SensorSession& session, const Batch& batch,
                  const Observation& seen, engine::Event event);
  void RefuseGraph(SensorHost& host, const SensorSession& session, const absl::Status& status);
  void GraphChanged(SensorHost& host, engine::Event event);
  void GrantCredit(SensorHost& host, SensorSession& session);
  void SendSetup(const std::string& host_name, SensorHost& host, SensorSession& session);
  void SendSetups();
  void CheckSensors(Instant now);

  // robot_inventory.cc
  void SetSensors(const RobotConfig& config, Instant now);
  void SetActuators(const RobotConfig& config, Instant now);

  // robot_losses.cc
  void TellLosses(Instant now);
  // Observations that the hello leaves out and that are lost: neither with the sensor nor judged.
  uint64_t LostBefore(SensorHost& host, const SensorHello& hello);
  void TellStoreWentBack(const std::string& how);
  // A message was not told what inspections say of it.
  void CountSkipped(const MessageSeen& message, uint64_t inspections);
  // Reasons of the last ten minutes; empty = every message was inspected.
  std::string SkippedText(Instant now) const;

  // robot_findings.cc
  // True if rules are to judge it.
  bool TakeFinding(const std::string& host, const std::string& incarnation,
                   const FindingSeen& finding);
  void ExpireFindings(Instant now);

  // robot_terms.cc
  absl::StatusOr<ShownTerm> TermToReset(const TermResetOrder& order) const;
  void OnTermToReset(const TermResetOrder& order, const absl::StatusOr<uint64_t>& term,
                     LevelReply reply);
  // robot_actuators.cc
  void AskAndArm(const Arming& arming);
  void OnStoreAnswer(const absl::Status& status, const Arming& arming);
  void Arm(ActuatorHost& host, const Arming& arming);
  void Reconcile(const Arming& arming, const std::optional<std::string>& known);
  std::optional<std::string> KnownLevel(const DecisionId& decision_id) const;
  void CheckActuators(Instant now);
  void SendCommands(Instant now);
  void TellMissingPrograms();
  void AdoptFound(const std::string& host_name, ActuatorSession& session,
                  std::optional<levels::LevelIndex> effective);
  void TellFloor(const std::string& host_name, ActuatorHost& host);
  void TellDegraded(const std::string& host_name, ActuatorHost& host,
                    const std::vector<std::string>& degraded);
  void SendLease(ActuatorSession& session);
  void UpdateActuation(Instant now);
  void HandleProgramResult(const ProgramResult& result, Instant now);
  bool ActuatorLive(const ActuatorHost& host, Instant now) const;
  std::vector<ros2::Guid> Participants() const;  // of all agents
  void TakeParticipant(const std::string& agent, const ros2::Guid& participant,
                       OwnParticipants& known);
  void ExpireParticipants(Instant now);
  std::vector<std::string> ProtectedParts() const;

  // Sessions and refusals of processes with one agent's key (second_holder.h).
  void BeginSession(absl::string_view agent, const std::string& host, SecondHolder& second,
                    const std::string& peer);
  void RefuseSecond(SecondHolder& second, const std::string& peer);
  void TellSecond(absl::string_view agent, const std::string& host, SecondHolder& second);

  // robot_drill.cc
  void AdvanceDrill(Instant now);
  void EndDrill();

  // robot.cc
  // `message`: what a MessageEvent was made of. `remark`: added to what alerts say of the event.
  void Run(const engine::Event& event, const MessageSeen* message = nullptr,
           absl::string_view remark = "");
  void External(engine::ExternalEvent event);
  void Perform(const engine::Outcome& outcome, const std::string& event);
  void TakeTransition(const engine::TransitionEffect& effect);
  void Adopt(levels::LevelIndex level, const DecisionId& seen, const std::string& why);
  void RecordDecision(const levels::Transition& transition, const engine::SharedTrace& trace);
  void Order(const levels::Transition& transition);
  void Alert(engine::AlertEffect alert, const std::string& event);
  // What one place in the code says is one kind, for the limit.
  void OwnAlert(engine::Severity severity, const std::string& text,
                std::source_location where = std::source_location::current());
  void UpdateEvidence(Instant now);
  bool HasBacklog() const;
  std::vector<std::string> EvidenceProblems(Instant now) const;
  void PublishStatus();
  void Decide(const levels::Transition& transition, const LevelOrder& order, LevelReply reply,
              LevelAnswer answer);

  // robot_recording.cc
  // Hands everything collected to the recorder; sequences up to now are acknowledged when durable.
  void Flush();
  store::Checkpoint MakeCheckpoint() const;
  void OnRecorded(const absl::Status& status);
  void Acknowledge(const store::HighWater& judged);
  void OrderRecorded(const levels::Transition& lowering);
  void TakeBack(const levels::Transition& lowering, engine::Severity severity, std::string why);
  void SaveRaises();  // what is not recorded yet, from the store's reserve

  RobotConfig config_;
  Policy policy_;
  Timing timing_;
  Ports ports_;
  engine::RobotState state_;
  EvidenceGate evidence_;
  Sight sight_;
  std::shared_ptr<const engine::InterestPlan> interest_;
  std::shared_ptr<const ros2::TopicNames> kept_topics_;
  CoverageAlarm coverage_alarm_;
  LossAlarm loss_alarm_;
  ToldOnce told_;
  absl::btree_map<std::string, RecentLosses> skipped_;  // by reason: inspections not made
  AlertLimiter alert_limiter_;
  AlertLimiter own_alert_limiter_{kOwnAlertLimits};
  FindingRegistry findings_;
  CommandReconciler ledger_;
  GraphHistory graph_history_;
  absl::btree_map<std::string, SensorHost> sensors_;
  absl::btree_map<std::string, ActuatorHost> actuators_;
  ReceiptHistory receipts_;
  std::optional<RunningDrill> drill_;
  DurableOutbox outbox_;
  WaitingOrders orders_;
  bool retired_ = false;
  std::string policy_problem_;
  std::vector<std::shared_ptr<EventRecorder>> taps_;
  ControlLine control_line_;
  MessageLine message_line_;
  // Refusals already recorded: rule, from, to, reason → id.
  absl::btree_map<std::string, std::string> refusal_ids_;
  absl::btree_map<std::string, std::pair<std::string, uint64_t>> refused_orders_;  // cause, level
  Stage reported_stage_ = Stage::kRequested;
  bool failure_alerted_ = false;
  bool draining_ = false;
  int64_t graph_changed_unix_ns_ = 0;
  int64_t started_ns_ = 0;
  NextTimes next_;
  RobotStatus published_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_H_
