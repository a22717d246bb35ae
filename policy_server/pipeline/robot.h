// One robot on the server: everything it is and everything that happens to it, in one thread.
//
// Observations come in, events are judged, effects are recorded and sent. Invariants kept here:
//   - The level goes down only by a soft rule step with complete evidence, or by an operator.
//   - A raise is commanded at once while it is being recorded; a lowering is commanded only when it
//     is durable, and taken back (as a new, higher decision) if it cannot be recorded.
//   - An observation is acknowledged only when its effects and its sequence number are durable.
//   - What an agent says of itself grants nothing: host and role come from its certificate.
#ifndef RIPS_POLICY_SERVER_PIPELINE_ROBOT_H_
#define RIPS_POLICY_SERVER_PIPELINE_ROBOT_H_

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/types/span.h"
#include "policy_server/engine/evaluator.h"
#include "policy_server/pipeline/alert_limiter.h"
#include "policy_server/pipeline/command_ledger.h"
#include "policy_server/pipeline/coverage.h"
#include "policy_server/pipeline/drill_run.h"
#include "policy_server/pipeline/evidence_gate.h"
#include "policy_server/pipeline/findings_book.h"
#include "policy_server/pipeline/inbound.h"
#include "policy_server/pipeline/level_order.h"
#include "policy_server/pipeline/links.h"
#include "policy_server/pipeline/policy.h"
#include "policy_server/pipeline/ports.h"
#include "policy_server/pipeline/receipt_log.h"
#include "policy_server/pipeline/robot_config.h"
#include "policy_server/pipeline/sensor_health.h"
#include "policy_server/pipeline/sequence_track.h"
#include "policy_server/store/store.h"
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
  void OnSensorBeat(const std::string& host, const SensorLink* link, const SensorBeat& beat);
  void OnInterestAnswer(const std::string& host, const SensorLink* link,
                        const InterestAnswer& answer);
  // Control batches are judged at once. A message batch waits for those before it and for the
  // inspections that its messages need (robot_inspection.cc).
  void OnBatch(const std::string& host, const SensorLink* link, std::shared_ptr<const Batch> batch);
  void OnSensorGone(const std::string& host, const SensorLink* link);

  // ---- actuators
  void OnActuatorHello(const std::string& host, std::shared_ptr<ActuatorLink> link,
                       const ActuatorHello& hello);
  void OnActuatorBeat(const std::string& host, const ActuatorLink* link, const ActuatorBeat& beat);
  void OnReceipt(const std::string& host, const ActuatorLink* link, const Receipt& receipt);
  void OnActuatorGone(const std::string& host, const ActuatorLink* link);

  // ---- operators; `reply` is called once, later, on the shard's thread.
  void Raise(const LevelOrder& order, LevelReply reply);
  void DeEscalate(const LevelOrder& order, LevelReply reply);
  // Rules may lower soft levels again, and run again after a `crash`.
  absl::Status ResumeRules(const std::string& operator_name, const std::string& reason);
  // Answered when each actuator has, or after kDrillAnswerNs. InvalidArgument for no level of the
  // robot, FailedPrecondition if no actuator is attached or another drill is under way.
  void StartDrill(const DrillOrder& order, DrillReply reply);
  // What the actuators answered since the start.
  const ReceiptLog& receipts() const { return receipts_; }
  RobotStatus Status() const;
  // Tells the tap every event from now on, before it is judged. ResourceExhausted if there are
  // kTapsMax already.
  static constexpr size_t kTapsMax = 4;
  absl::Status AddTap(std::shared_ptr<Tap> tap);
  const ros2::RosGraph& graph() const { return state_.graph.get(); }
  // What sensors find whatever the rules say, and what stands; oldest first.
  std::vector<FindingSeen> findings() const { return findings_.standing(); }
  int64_t graph_changed_unix_ns() const { return graph_changed_unix_ns_; }
  const levels::LevelTable& levels() const { return state_.level.table(); }
  // What the rules in force need of each topic.
  const engine::InterestPlan& interest() const { return *interest_; }
  // Of the sensors that report messages.
  std::vector<SensorInterest> SensorInterests() const;
  // Every sensor host of the inventory, sorted.
  std::vector<SensorCoverage> Coverage() const;

  // ---- time; call at least every 50 ms.
  void OnTime();
  // Another bundle, between two events. FailedPrecondition: the old one stays, with an alert.
  absl::Status SwapPolicy(Policy policy);
  // Leases from now on last drain_lease: the server is about to stop.
  void Drain();

  const std::string& id() const { return config_.id; }

 private:
  struct SensorSession {
    std::shared_ptr<SensorLink> link;
    std::string incarnation;
    // Server time minus the sensor's boottime, fixed at Hello.
    int64_t boottime_offset_ns = 0;
    int64_t unix_offset_ns = 0;
    int64_t heard_ns = 0;
    int64_t peer_boottime_ns = 0;
    // Announced in Hello: evidence is incomplete until judged up to here.
    std::vector<SpooledRange> spooled;
    uint64_t judged_bytes = 0;
    uint64_t granted_bytes = 0;
    // Ids; what it uses is what it says.
    std::string interest_wanted;
    std::string interest_in_use;
    // Why it does not use the one wanted; printable.
    std::string interest_problem;
    ClockSkew skew;
  };
  struct SensorHost {
    std::string name;
    std::optional<SensorSession> session;
    SequenceTrack sequences;
    // Of the incarnation whose graph is held.
    std::string graph_incarnation;
    uint64_t graph_version = 0;
    // Collects an unsettled snapshot; becomes the robot's graph when settled.
    ros2::RosGraph graph;
    bool settled = false;
    bool lost = false;
    int64_t gone_since_ns = 0;
    RestartCount restarts;
    RecentLosses losses;
    SensorStateSeen state;
  };
  struct ActuatorSession {
    std::shared_ptr<ActuatorLink> link;
    int64_t heard_ns = 0;
    int64_t peer_boottime_ns = 0;
    ActuatorBeat beat;
  };
  struct ActuatorHost {
    std::optional<ActuatorSession> session;
    // The newest it said, oldest first; they stand while it is away. More than one: on the bus a
    // process that was killed goes on until its lease ends, and is no stranger for that.
    std::deque<ros2::Guid> participants;
    // As it said last.
    std::vector<std::string> protected_parts;
    std::optional<uint64_t> drifts;
    std::vector<std::string> degraded;
    bool lost = false;
    int64_t gone_since_ns = 0;
  };

  Robot(RobotConfig config, Policy policy, Timing timing, const store::RobotRecord& record,
        levels::LevelMachine level, Ports ports);

  // A message batch and what its messages were told.
  struct Inspecting {
    uint64_t ticket = 0;
    std::string host;
    std::shared_ptr<SensorLink> link;
    std::shared_ptr<const Batch> batch;
    // Under which it was asked.
    std::shared_ptr<const engine::Program> program;
    // By observation, then by index of the program's inspections; empty where none is needed.
    std::vector<std::vector<engine::Verdict>> verdicts;
    // Observations before this one have been looked at.
    size_t asked = 0;
    // Answers that have not come.
    size_t waiting = 0;
  };

  // robot_inspection.cc
  void AdvanceMessages();
  bool AskInspections(Inspecting& batch);
  void AskInspection(Inspecting& batch, size_t index, std::vector<uint32_t> needed);
  void OnInspected(uint64_t ticket, size_t index, const std::vector<uint32_t>& asked,
                   const std::vector<engine::Verdict>& verdicts);

  // robot_coverage.cc
  void UseInterest();  // that of the policy in force
  // True if that is something else than before.
  bool AskInterest(SensorSession& session);
  // Empty if it watches what the rules need.
  std::string InterestProblem(const SensorHost& host) const;
  void TakeHello(SensorHost& host, const SensorHello& hello, Instant now);
  // True if the sensor is overloaded now and was not before.
  bool TakeState(SensorHost& host, const SensorStateSeen& state);
  void CountLost(SensorHost& host, uint64_t count);
  void UpdateCoverage(Instant now);

  // robot_sensors.cc
  SensorSession* LiveSensor(const std::string& host, const SensorLink* link);
  // `verdicts` as in Inspecting; may be empty.
  void JudgeBatch(const std::string& host, const SensorLink* link, const Batch& batch,
                  const std::vector<std::vector<engine::Verdict>>& verdicts);
  // Numbers that a sensor gave and that will not come: counted here, once. Its own Loss records
  // tell of what never had a number.
  void Missing(SensorHost& host, uint64_t count);
  void Judge(SensorHost& host, SensorSession& session, bool primary, const Batch& batch,
             size_t index, absl::Span<const engine::Verdict> inspections);
  engine::MessageEvent ToEvent(const MessageSeen& message) const;
  static engine::LossEvent ToEvent(const LossSeen& loss, const SensorSession& session);
  void JudgeSnapshot(SensorHost& host, const SensorSession& session,
                     const GraphSnapshotSeen& snapshot, engine::Event event);
  void JudgeDelta(SensorHost& host, const SensorSession& session, const GraphDeltaSeen& delta,
                  engine::Event event);
  void RefuseGraph(SensorHost& host, const SensorSession& session, const absl::Status& status);
  absl::Status TakeSnapshot(SensorHost& host, const std::string& incarnation,
                            const GraphSnapshotSeen& snapshot);
  absl::Status TakeDelta(SensorHost& host, const std::string& incarnation,
                         const GraphDeltaSeen& delta);
  void GraphChanged(SensorHost& host, engine::Event event);
  void GrantCredit(SensorHost& host, SensorSession& session);
  void SendSetup(const std::string& host_name, SensorHost& host, SensorSession& session);
  void CheckSensors(Instant now);

  // robot_findings.cc
  // True if rules are to judge it.
  bool TakeFinding(const std::string& host, const std::string& incarnation,
                   const FindingSeen& finding);
  void ExpireFindings(Instant now);

  // robot_actuators.cc
  absl::Status Reconcile(const std::string& host_name, const ActuatorHello& hello);
  void CheckActuators(Instant now);
  void SendCommands(Instant now);
  // Tells of programs that rules name and no actuator offers, once.
  void TellMissingPrograms();
  void TellDegraded(const std::string& host_name, ActuatorHost& host,
                    const std::vector<std::string>& degraded);
  void SendLease(ActuatorSession& session);
  void UpdateActuation(Instant now);
  void HandleProgramResult(const ProgramResult& result, Instant now);
  bool ActuatorLive(const ActuatorHost& host, Instant now) const;
  std::vector<ros2::Guid> OwnParticipants() const;
  // Of all actuators, sorted, each once.
  std::vector<std::string> ProtectedParts() const;

  // robot_drill.cc
  void AdvanceDrill(Instant now);
  void EndDrill();

  // robot.cc
  // `message`: what a MessageEvent was made of.
  void Run(const engine::Event& event, const MessageSeen* message = nullptr);
  void External(engine::ExternalEvent event);
  void Perform(const engine::Outcome& outcome, const std::string& event);
  void TakeTransition(const engine::TransitionEffect& effect);
  void Adopt(levels::LevelIndex level, const Mark& seen, const std::string& why);
  void RecordDecision(const levels::Transition& transition);
  void Order(const levels::Transition& transition);
  void Alert(engine::AlertEffect alert, const std::string& event);
  void OwnAlert(engine::Severity severity, const std::string& text);
  void UpdateEvidence(Instant now);
  std::vector<std::string> EvidenceProblems(Instant now) const;
  // Hands everything collected to the recorder; sequences up to now are acknowledged when durable.
  void Flush();
  void OnRecorded(const absl::Status& status, const store::WriteBatch& recorded,
                  const store::HighWater& judged, const std::vector<levels::Transition>& lowerings);
  void TakeBack(const levels::Transition& lowering, const absl::Status& why);
  void PublishStatus();
  // True if the order repeats an earlier one: it was answered as that was.
  bool AnswerRepeated(const LevelOrder& order, const LevelReply& reply) const;
  void Decide(const levels::Transition& transition, const LevelOrder& order, LevelReply reply,
              LevelAnswer answer);

  RobotConfig config_;
  Policy policy_;
  Timing timing_;
  Ports ports_;
  engine::RobotState state_;
  EvidenceGate evidence_;
  // What the rules in force need.
  std::shared_ptr<const engine::InterestPlan> interest_;
  CoverageAlarm coverage_alarm_;
  // Of the graph whose endpoints were counted last, and participants of RIPS.
  uint64_t counted_revision_ = 0;
  std::vector<ros2::Guid> counted_without_;
  AlertLimiter alert_limiter_;
  FindingsBook findings_;
  CommandLedger ledger_;
  absl::btree_map<std::string, SensorHost> sensors_;
  absl::btree_map<std::string, ActuatorHost> actuators_;

  ReceiptLog receipts_;
  struct RunningDrill {
    DrillOrder order;
    DrillRun run;
    DrillReply reply;
  };
  std::optional<RunningDrill> drill_;

  // Collected since the last Flush.
  store::WriteBatch pending_;
  std::vector<levels::Transition> pending_lowerings_;
  bool sequences_moved_ = false;
  bool variables_changed_ = false;
  std::vector<std::shared_ptr<Tap>> taps_;
  // Message batches in the order they came; only the first is being inspected.
  std::deque<Inspecting> message_line_;
  uint64_t last_ticket_ = 0;
  bool advancing_ = false;
  // Refusals already recorded: rule, from, to, reason → id.
  absl::btree_map<std::string, std::string> refusal_ids_;
  struct Waiting {
    std::string request_id;
    LevelReply reply;
    LevelAnswer answer;
  };
  // Operators waiting for a decision to be durable, by mark.
  absl::btree_map<Mark, Waiting> waiting_;
  // The newest answers by request id, oldest first.
  std::deque<std::pair<std::string, LevelAnswer>> answered_;

  // A lowering that is not durable yet must not be commanded.
  Mark awaiting_durable_;
  Stage reported_stage_ = Stage::kRequested;
  // As told last; empty = none.
  std::string missing_programs_;
  bool failure_alerted_ = false;
  bool store_failing_ = false;
  bool draining_ = false;
  int64_t graph_changed_unix_ns_ = 0;
  int64_t started_ns_ = 0;
  int64_t beat_at_ns_ = 0;
  int64_t tick_at_ns_ = 0;
  int64_t checkpoint_at_ns_ = 0;
  RobotStatus published_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_PIPELINE_ROBOT_H_
