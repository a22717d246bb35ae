// One robot on the server, on its thread: turns what reaches it into inputs of its core, and
// performs the core's actions. Decides nothing; see core/robot_core.h.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <source_location>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/server/robot/core/robot_core.h"
#include "policy_server/server/robot/performer.h"
#include "policy_server/server/robot/ports.h"
#include "policy_server/server/store/records.h"

namespace rips::pipeline {

// Not thread-safe: one shard owns it and calls everything. Ports outlive it.
class Robot {
 public:
  // `record` and `tenure`: as the store gave them when the robot was acquired for this start.
  // InvalidArgument if the recorded level is not one of the policy's.
  static absl::StatusOr<std::unique_ptr<Robot>> Create(RobotConfig config, Policy policy,
                                                       Timing timing,
                                                       const store::RobotRecord& record,
                                                       uint64_t tenure, Ports ports);

  // ---- sensors; `link` names the session, calls of replaced sessions are ignored.
  void OnSensorHello(const std::string& host, std::shared_ptr<SensorLink> link,
                     const SensorHello& hello);
  void OnSensorHeartbeat(const std::string& host, const SensorLink* link,
                         const SensorHeartbeat& heartbeat);
  void OnInterestAnswer(const std::string& host, const SensorLink* link,
                        const InterestAnswer& answer);
  // Control is judged at once, for a turn: while HasControl, Advance comes before other control,
  // while HasMessages, before other messages. A message waits for those before it, for its
  // inspections, and for the graph that it names.
  void OnBatch(const std::string& host, const SensorLink* link, std::shared_ptr<const Batch> batch);
  bool HasControl() const { return core_->has_control(); }
  bool HasMessages() const { return core_->has_messages(); }
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
  void Approve(const ApprovalOrder& order, LevelReply reply);
  void OnOperatorBanned(const std::string& identity) { Do(input::OperatorBanned{identity}); }
  void ResetTerm(const TermResetOrder& order, LevelReply reply);
  absl::Status ResumeRules(const std::string& operator_name, const std::string& reason);
  // As MaintenanceOrders::OnSet.
  absl::Status SetMaintenance(const MaintenanceOrder& order);
  LevelAnswer SendSignal(const SignalOrder& order);
  void RecordRefusedOrder(const LevelOrder& order, const absl::Status& why);
  // RIPS's own alert of what others found out about its agents; each caller is a kind.
  void Report(engine::Severity severity, const std::string& text,
              std::source_location where = std::source_location::current());
  // The key of one of its agents was used for what none of ours does.
  void OnKeyMisused(input::KeyMisused misuse) { Do(std::move(misuse)); }
  // As Drills::Start.
  void StartDrill(const DrillOrder& order, DrillReply reply);
  // The recorder gets every event that is judged. ResourceExhausted past kTapsMax.
  static constexpr size_t kTapsMax = 4;
  absl::Status AddTap(std::shared_ptr<EventRecorder> tap);
  // From now on the robot's sensors are asked for what `also` needs, too, and the recorder gets
  // every event, muted ones too, until it wants no more. Verdicts do not change. Takes the place of
  // the one before; null: ends it. `also` is not null if `shadow` is not.
  void SetShadow(std::shared_ptr<ShadowRecorder> shadow, std::shared_ptr<const AlsoWatched> also);

  // ---- time; call at least every 50 ms. What agents sent waits for its turn for too long, or not.
  void SetBacklog(bool backlog) { backlog_ = backlog; }
  void OnTime();
  // Another bundle, between two events. FailedPrecondition: the old one stays, with an alert.
  absl::Status SwapPolicy(Policy policy);
  // Leases from now on last drain_lease: the server is about to stop.
  void Drain() { Do(input::Drain{}); }

  // ---- inventory
  // Other hosts, or another primary sensor, are listed from now on. Sessions of hosts that are no
  // longer listed, or whose part has changed, are closed. `config.id` is this robot's.
  void SetHosts(const RobotConfig& config) { Do(input::SetHosts{config}); }
  // Why the bundle that the inventory names is not the one in force; empty = it is.
  void SetPolicyProblem(std::string problem) { Do(input::PolicyProblem{std::move(problem)}); }
  // No longer listed: closes its sessions with `why`, answers orders that wait, and records what is
  // left. Afterwards only OnTime is called, until gone(). A robot that has another owner retires by
  // itself, records nothing more, and reports it (Ports::fenced).
  void Retire(const absl::Status& why) { Do(input::Retire{why}); }
  bool gone() const { return core_->gone(); }

  const std::string& id() const { return core_->id(); }
  // What is known now.
  const RobotCore& core() const { return core_->At(Now()); }
  RobotStatus Status() const { return core().Status(); }

 private:
  explicit Robot(Ports ports, std::string id);

  Moment Now() const;
  // Has the core judge the input, performs its actions, and goes on with what was answered at once.
  void Do(Input input);
  // Of the flight recording, if there is one.
  void BeginPiece();
  // Judge what sensors have sent, until the turn is over.
  void AdvanceControl();
  void AdvanceMessages();

  Performer performer_;
  std::unique_ptr<RobotCore> core_;
  bool backlog_ = false;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_ROBOT_H_
