// Desired against reported, for all actuators of one robot: which commands are due. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_COMMAND_RECONCILER_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_COMMAND_RECONCILER_H_

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "policy_server/policy/levels/level_table.h"
#include "policy_server/server/robot/context/id_source.h"
#include "policy_server/server/robot/model/actuator_inbound.h"
#include "policy_server/server/robot/model/outbound.h"
#include "services/base/clock.h"
#include "services/base/decision_id.h"

namespace rips::pipeline {

// Of the newest decision, over all listed actuators. CommandReconciler never says kContradicted:
// that is what the robot makes of kVerified (ActuatorSide).
enum class Stage { kRequested, kAcknowledged, kVerified, kFailed, kContradicted };
absl::string_view ToString(Stage stage);

struct LedgerTiming {
  // No acknowledgement: the same command is sent again.
  int64_t resend_ns = 2 * kNanosPerSecond;
  // Failed: tried again with a new command.
  int64_t retry_ns = 5 * kNanosPerSecond;
  // Budget of one level command; no final receipt by then counts as failed.
  int64_t command_ns = 20 * kNanosPerSecond;
  int64_t program_ns = 10 * kNanosPerSecond;
};

struct Outgoing {
  std::string host;
  Command command;
};

struct ProgramResult {
  uint64_t run_id = 0;
  bool ok = false;
  std::string detail;
};

struct ReceiptResult {
  // The receipt concerns the newest decision.
  bool level_changed_stage = false;
  // The actuator refused our term: another server has commanded it.
  bool stale_term = false;
  std::string detail;
  std::optional<ProgramResult> program;
};

// Not thread-safe. Hosts are those of the inventory; others are never passed in.
class CommandReconciler {
 public:
  // `ids` names commands; it outlives this.
  CommandReconciler(std::vector<std::string> hosts, IdSource* ids, LedgerTiming timing = {});

  // The decision that every actuator must reach. A repeated decision id changes nothing.
  // `lowers`: it is verified only at exactly this level, otherwise also above it.
  void Order(const DecisionId& decision_id, levels::LevelIndex level, const std::string& level_name,
             const std::string& cause, bool lowers);

  // Other actuators are listed from now on. A new one has to reach the newest decision too; of one
  // that is no longer listed nothing is known any more.
  void SetHosts(const std::vector<std::string>& hosts);

  // `held_*`: what the actuator says it holds (none = nothing). One that holds the newest decision
  // and its level already is not commanded again; its heartbeats tell whether the level is
  // verified.
  void Attach(const std::string& host, const DecisionId& held, levels::LevelIndex held_level,
              const std::string& held_name, std::vector<std::string> programs, Instant now);
  void Detach(const std::string& host);
  // The level of one of the newest kOrdersKept decisions that were ordered; nullopt if the decision
  // is older or not of this process.
  std::optional<std::string> OrderedLevel(const DecisionId& decision_id) const;
  bool attached(const std::string& host) const;

  // Takes the run to the first attached actuator whose allow-list has the program. False if there
  // is none: the caller reports failure.
  bool Run(uint64_t run_id, const std::string& program, const std::vector<std::string>& args,
           Instant now);

  // Those of `programs` that are on no actuator's allow-list. Empty until every actuator has told
  // its own.
  std::vector<std::string> NotOffered(const std::vector<std::string>& programs) const;

  ReceiptResult OnReceipt(const std::string& host, const Receipt& receipt, Instant now);
  // What the actuator reports of itself between receipts. True if a level that was verified is no
  // longer so.
  bool OnHeartbeat(const std::string& host, levels::LevelIndex effective, bool verified,
                   Instant now);

  // Commands to send now. `term` fences them. Call after every change and at least each 100 ms.
  std::vector<Outgoing> Due(uint64_t term, Instant now);
  // Programs whose time is up or whose actuator has gone.
  std::vector<ProgramResult> ExpiredPrograms(Instant now);

  Stage stage() const;
  // The newest decision that was ordered; none = nothing yet.
  const DecisionId& decision_id() const { return decision_id_; }
  levels::LevelIndex level() const { return level_; }
  const std::string& level_name() const { return level_name_; }
  // Why it failed, for people; empty otherwise.
  std::string failure() const;

 private:
  struct Actuator {
    bool attached = false;
    DecisionId held;
    levels::LevelIndex held_level = 0;
    std::string held_name;
    // A heartbeat has come in this session.
    bool beaten = false;
    // Reported before the first heartbeat, of a command that this session did not send.
    std::string old_failure;
    // None until it has attached for the first time.
    std::optional<std::vector<std::string>> programs;
    // Of the newest decision.
    Stage stage = Stage::kRequested;
    std::string failure;
    std::string command_id;
    int64_t sent_ns = 0;
    int64_t first_sent_ns = 0;
    int64_t retry_at_ns = 0;
  };
  static bool Offers(const Actuator& actuator, const std::string& program);

  struct ProgramRun {
    std::string command_id;
    std::string host;
    RunProgram program;
    int64_t started_ns = 0;
    bool sent = false;
  };

  struct Ordered {
    DecisionId decision_id;
    levels::LevelIndex level = 0;
    std::string level_name;
  };
  static constexpr size_t kOrdersKept = 64;

  // The actuator holds the decision of this decision id, unless it holds a newer one.
  void Hold(Actuator& actuator, const DecisionId& decision_id) const;
  void StartAnew(Actuator& actuator) const;
  void Fail(Actuator& actuator, const std::string& why, Instant now) const;
  std::optional<Command> LevelCommandDue(Actuator& actuator, uint64_t term, Instant now);
  ReceiptResult OnProgramReceipt(uint64_t run_id, const Receipt& receipt);

  IdSource* ids_;
  LedgerTiming timing_;
  absl::btree_map<std::string, Actuator> actuators_;
  absl::btree_map<uint64_t, ProgramRun> runs_;
  // The newest decisions, oldest first.
  std::deque<Ordered> orders_;
  DecisionId decision_id_;
  levels::LevelIndex level_ = 0;
  std::string level_name_;
  std::string cause_;
  bool lowers_ = false;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_COMMAND_RECONCILER_H_
