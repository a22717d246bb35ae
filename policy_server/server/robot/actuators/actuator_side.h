// The actuators of one robot: their sessions, the level that each must reach against what it
// reports, programs that run on them, and what is wrong with them. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_ACTUATOR_SIDE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_ACTUATOR_SIDE_H_

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/policy/levels/transition.h"
#include "policy_server/server/robot/actuators/command_reconciler.h"
#include "policy_server/server/robot/actuators/level_witness.h"
#include "policy_server/server/robot/actuators/receipt_history.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/durable_outbox.h"
#include "policy_server/server/robot/context/own_agents.h"
#include "policy_server/server/robot/model/robot_status.h"

namespace rips::pipeline {

// What an actuator found on its robot, above what was decided; to be adopted.
struct FoundLevel {
  levels::LevelIndex level = 0;
  std::string why;
};

// Not thread-safe. All that it is given outlives it.
class ActuatorSide {
 public:
  ActuatorSide(Context* context, Alerts* alerts, DurableOutbox* outbox, OwnAgents* own_agents,
               const levels::LevelMachine* level);

  // ---- sessions
  bool Lists(const std::string& host) const { return hosts_.contains(host); }
  bool HasLiveSession(const std::string& host) const;
  // A session begins, of an actuator that was admitted. A session before it is closed.
  void Arm(const input::ActuatorHello& in);
  // It has had a session since this process began.
  bool Met(const std::string& host) const { return hosts_.at(host).met; }
  // The newest decision that the host has verified; none = nothing.
  DecisionId verified(const std::string& host) const { return hosts_.at(host).verified; }
  // True unless the session is another one.
  bool OnGone(const std::string& host, SessionId session);
  // Closes sessions that are silent for too long, and reports hosts without one. The hosts whose
  // session has ended.
  std::vector<std::string> CheckLost();
  // Those that are no longer listed, or all: closed with `why`.
  void SetHosts(const std::vector<std::string>& hosts);
  void CloseAll(const absl::Status& why);

  // ---- what they report
  std::optional<FoundLevel> OnHeartbeat(const input::ActuatorHeartbeat& in);
  // False unless the session is the host's.
  bool Hear(const input::Receipt& in);
  // Heard, and of no drill. A program's result, if it is one.
  std::optional<ProgramResult> OnReceipt(const input::Receipt& in);

  // ---- what they are sent
  // Every actuator must reach it from now on. Commands leave at once.
  void Order(const levels::Transition& transition, const std::string& cause);
  // What the store says was ordered before this start.
  void Restore(const DecisionId& decision_id, const std::string& level_name);
  // Empty: the program was sent. Else: why not.
  std::string Run(const engine::RunProgramEffect& run);
  void SendCommands();
  void Send(const Outgoing& outgoing);
  // `evidence_complete`: nothing that could hide an attack is wrong.
  void SendLease(const std::string& host, bool evidence_complete);
  void SendLeases(bool evidence_complete);
  std::vector<ProgramResult> ExpiredPrograms() {
    return reconciler_.ExpiredPrograms(context_.now());
  }
  void ReportMissingPrograms();

  // ---- whether what they read back is so
  LevelWitness& witness() { return witness_; }

  // ---- what is known of them
  // Records the stage of the newest decision if it has changed, and what rules are to make of it.
  engine::Actuation UpdateStage();
  // The newest decision was ordered and is verified on every actuator, and nothing contradicts it.
  bool verified() const;
  Stage stage() const;
  // Hosts with a session.
  std::vector<std::string> attached() const;
  // Hosts whose absence was reported.
  std::vector<std::string> lost() const;
  // An actuator has read back its parts.
  bool PartsVerified() const;
  void AddProblems(std::vector<std::string>& problems) const;
  void AddStatus(RobotStatus& status) const;
  // As each host with a session said last; a host whose level has no firewall is left out.
  std::map<std::string, model::FirewallDrops> FirewallDrops() const;
  const CommandReconciler& reconciler() const { return reconciler_; }
  const ReceiptHistory& receipts() const {
    return receipts_;
  }  // since the start; older ones are in the store

 private:
  struct Session {
    SessionId id = 0;
    // It began without a state of its own: above this level, what it holds is what it found.
    std::optional<levels::LevelIndex> found_above;
    // The highest that was ordered in this session: where it may be because we said so.
    levels::LevelIndex ordered_most = 0;
    int64_t heard_ns = 0;
    int64_t peer_boottime_ns = 0;
    ActuatorHeartbeat heartbeat;
  };
  // Of the inventory, with or without a session.
  struct Host {
    std::optional<Session> session;
    std::optional<uint64_t> drifts;
    // As reported last.
    std::vector<std::string> degraded;
    // Why it held a level of its own, as reported last; empty = it did not.
    std::string floor;
    bool lost = false;
    int64_t gone_since_ns = 0;
    bool met = false;
    DecisionId verified;
    // That its hello names no inactive nodes was reported.
    bool silence_reported = false;
  };

  // What became of the newest decision that was ordered.
  struct Newest {
    int64_t ordered_ns = 0;
    bool raises = false;
    // Every actuator has read it back, some time.
    bool reached = false;
    bool failure_reported = false;
    bool recovery_reported = false;
    bool absence_reported = false;
  };

  const levels::LevelTable& levels() const { return level_.table(); }
  void UpdateWitness();
  void ReportStage(Stage before, Stage stage);
  bool Live(const Host& host) const;
  void End(const std::string& name, Host& host);
  void OnStateLost(const std::string& name, Host& host, const ActuatorHello& hello);
  std::optional<FoundLevel> Found(const std::string& name, Session& session,
                                  std::optional<levels::LevelIndex> effective) const;
  // A raise that an actuator cannot hear of; in a maintenance, too.
  void ReportAbsence();
  void ReportFloor(const std::string& name, Host& host);
  void ReportDegraded(const std::string& name, Host& host);

  Context& context_;
  Alerts& alerts_;
  DurableOutbox& outbox_;
  OwnAgents& own_agents_;
  const levels::LevelMachine& level_;
  absl::btree_map<std::string, Host> hosts_;
  CommandReconciler reconciler_;
  ReceiptHistory receipts_;
  Stage reported_stage_ = Stage::kRequested;
  Newest newest_;
  LevelWitness witness_;
  // Programs that no actuator offers, as reported; empty = none.
  std::string missing_programs_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_ACTUATOR_SIDE_H_
