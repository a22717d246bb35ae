// Decides what level the robot is held at: obeys marked and fenced commands, raises a floor of its
// own when the server's lease ends, and never goes lower by accident.
//
// Pure: no thread, clock, file or wire. Inputs come with the time (CLOCK_BOOTTIME, nanoseconds);
// each gives the actions to do, in that order. Used by one thread.
//
// decided    the server's decision, named by a decision id; persisted
// floor      ours, volatile; raised by loss of the lease, of the state, or by a restart
// target     max(decided, floor): where the robot must be
// effective  where the robot is held. A raise sets it at once; a lowering only after read-back.
//            So effective >= target always, and effective goes down only to the target.
//
// What becomes of a SetLevel (first line that fits):
// | command                                        | receipt                    | effect        |
// |------------------------------------------------|----------------------------|---------------|
// | term below the highest seen                    | REFUSED_STALE              | none          |
// | id seen before                                 | the newest one of that id  | none          |
// | none, or of a later term, or unknown level     | REFUSED                    | none          |
// | decision id held already                       | as the held command's      | none          |
// | decision id below the held one                 | REFUSED_STALE              | none          |
// | `to` below the held level, `based_on` not held | REFUSED                    | none          |
// | `to` below the held level                      | ACKNOWLEDGED once recorded | then applied  |
// | else (raise, equal, or nothing decided yet)    | ACKNOWLEDGED               | applied, and  |
// |                                                |                            | recorded too  |
// After ACKNOWLEDGED comes VERIFIED (a lowering: at `to`; else at `to` or above), FAILED (and
// perhaps VERIFIED later: it is retried), or SUPERSEDED by a newer decision.
//
// The recorded state is lost if there is none, if it is corrupt, or if it names no decision or a
// level that is not in `levels`. A good state can still be an old one, from a backup. So every
// start compares the state with the robot:
// | known of the robot                    | floor                                 | first job   |
// | a decision, and held at that level    | none                                  | survey      |
// | a decision, and held higher           | the level it was held at ("restart")  | survey      |
// | state lost, but held at a known level | that one, or fail_safe if higher      | survey      |
// | state lost                            | fail_safe                             | survey      |
// | state lost, and fail_safe is `keep`   | the last level                        | enters it   |
// A target at the last level, or a robot without system modes, needs no survey. A survey reads back
// which level the robot's parts show (mode_survey.h); no level is entered before
// | the survey                            | then                                                |
// | shows a level above the target        | the floor rises to that level and is entered        |
// | shows a lower level, or none          | the target is entered                               |
// | is not over after kSurveyNsMax        | the target is entered; a late result can raise it   |
// | is overtaken by a SetLevel above the  | that level is entered at once; the result, which is |
// | target                                | what was read until then, can raise the floor       |
// The target meant is that of the start: a lowering that arrives during the survey follows it.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_LEVEL_CONTROLLER_H_
#define RIPS_MODE_ACTUATOR_DECIDE_LEVEL_CONTROLLER_H_

#include <cstdint>
#include <deque>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/decide/actuator_state.h"
#include "mode_actuator/decide/drift_watch.h"
#include "mode_actuator/decide/drop_watch.h"
#include "mode_actuator/decide/level_actions.h"
#include "mode_actuator/decide/receipt.h"
#include "services/base/clock.h"
#include "services/base/decision_id.h"
#include "services/model/command.h"

namespace rips::actuator {

// A lease longer than this is cut: no server may switch the floor off for good.
inline constexpr int64_t kLeaseNsMax = 10 * 60 * kNanosPerSecond;
// What a restarted actuator waits for its first lease before it counts as lost.
inline constexpr int64_t kStartGraceNs = 15 * kNanosPerSecond;
// A survey (kSurveyTime of its own) that takes longer no longer holds back the floor.
inline constexpr int64_t kSurveyNsMax = 3 * kNanosPerSecond;
// Floors raised within this time double the wait before the next one lifts, up to kFloorHoldNsMax.
inline constexpr int64_t kFloorMemoryNs = 10 * 60 * kNanosPerSecond;
inline constexpr int64_t kFloorHoldNsMax = 5 * 60 * kNanosPerSecond;
// A failed level is tried again after the reconcile period, doubled each time up to this.
inline constexpr int64_t kRetryNsMax = 10 * kNanosPerSecond;
// Receipts kept by command id, to answer duplicates.
inline constexpr size_t kRecentReceiptsMax = 64;

struct ExecutorOptions {
  std::vector<std::string> levels;       // least restrictive first; not empty, no duplicates
  std::optional<std::string> fail_safe;  // nullopt = `keep`: loss of the lease raises nothing
  int64_t fail_safe_after_ns = 0;        // counts from the end of the lease
  int64_t floor_hold_ns = 10 * kNanosPerSecond;
  int64_t reconcile_ns = 2 * kNanosPerSecond;
  std::set<std::string> on_drift;  // levels that have such steps
  bool survey = false;             // levels set system modes, which can be read back
};

class LevelController {
 public:
  // `loaded` is what DecodeState gave, or why there is nothing; a state that names a level not in
  // `options.levels` counts as lost. InvalidArgument if `options` contradict themselves.
  static absl::StatusOr<LevelController> Create(ExecutorOptions options,
                                                const absl::StatusOr<ActuatorState>& loaded,
                                                int64_t now_ns);

  // Once, first: re-applies the effective level, after a survey of the robot.
  Actions Start(int64_t now_ns);
  // A command that is a SetLevel.
  Actions OnSetLevel(const model::Command& command, int64_t now_ns);
  // Fencing for commands that are not levels: false if `term` is stale.
  bool AdmitTerm(uint64_t term);
  // False if the grant was ignored: stale term, older echo than known, an echo from the future.
  bool OnLease(const model::LeaseGrant& lease, int64_t now_ns);
  // Outcomes of jobs that were replaced are ignored, except of a survey.
  Actions OnOutcome(const LevelOutcome& outcome, int64_t now_ns);
  Actions OnPersisted(uint64_t sequence, const absl::Status& status, int64_t now_ns);
  // At least every 100 ms.
  Actions OnTick(int64_t now_ns);

  ExecutorReport Report(int64_t now_ns) const;
  std::optional<model::FirewallDrops> FirewallDrops(int64_t now_ns) const {
    return drop_watch_.Report(now_ns);
  }

 private:
  struct LevelCommand {
    std::string id;
    DecisionId decision_id;
    int to = 0;
    bool lowering = false;
    Receipt::Stage stage = Receipt::Stage::kAcknowledged;
  };
  struct Job {
    uint64_t attempt = 0;
    JobKind kind = JobKind::kEnter;
    int level = 0;
  };
  struct PendingLowering {
    LevelCommand command;
    uint64_t sequence = 0;
  };

  explicit LevelController(ExecutorOptions options) : options_(std::move(options)) {}

  void Load(const absl::StatusOr<ActuatorState>& loaded, int64_t now_ns);
  int LevelIndex(absl::string_view name) const;  // -1 = unknown
  int target() const { return decided_ > floor_ ? decided_ : floor_; }
  bool LeaseLive(int64_t now_ns) const { return lease_term_ > 0 && now_ns < lease_end_ns_; }
  // Nothing is entered before the survey's answer.
  bool surveying() const { return job_.has_value() && job_->kind == JobKind::kSurvey; }

  Receipt MakeReceipt(const LevelCommand& command, Receipt::Stage stage) const;
  void Send(Receipt receipt, Actions& actions);
  // The answer to a command that has no effect: a refusal, or the receipt it had before.
  std::optional<Receipt> Judge(const model::Command& command) const;
  void Persist(Actions& actions);
  ActuatorState StateNow() const;
  void Adopt(const LevelCommand& command, Actions& actions);

  void CheckLease(int64_t now_ns);
  void RaiseFloor(int level, std::string reason, int64_t now_ns);
  void TryLiftFloor(int64_t now_ns);
  int64_t FloorHold(int64_t now_ns) const;

  // Starts what brings the robot to the target, if nothing fitting is under way.
  void Reconcile(int64_t now_ns, Actions& actions);
  // What to do for the level that was entered last, if anything.
  std::optional<JobKind> NextJob(int goal, int64_t now_ns);
  void StartJob(JobKind kind, int to, int64_t now_ns, Actions& actions);
  void StartSurvey(int64_t now_ns, Actions& actions);
  void OnSurveyed(const LevelOutcome& outcome);
  void OnReached(const LevelOutcome& outcome, int level, int64_t now_ns, Actions& actions);
  void OnMissed(const LevelOutcome& outcome, const Job& job, int64_t now_ns, Actions& actions);
  // Reports the result of the held command if `level`, just reached or missed, is what it asks for.
  void ReportCommand(int level, Receipt::Stage stage, const LevelOutcome& outcome,
                     Actions& actions);

  ExecutorOptions options_;
  std::vector<Receipt> recent_;  // newest last; one per command id

  // Persisted.
  DecisionId decision_id_;
  int decided_ = -1;  // index into levels; -1 = nothing decided
  int effective_ = 0;
  uint64_t highest_term_ = 0;

  std::optional<LevelCommand> command_;  // of the held decision id; none after a restart
  std::optional<PendingLowering> pending_;
  uint64_t sequence_ = 0;          // last PersistState given out
  uint64_t settled_sequence_ = 0;  // newest that was answered
  bool dirty_ = false;             // what is on the disk differs, or may
  int64_t persist_retry_ns_ = 0;

  int floor_ = -1;
  std::string floor_reason_;
  bool lost_ = false;  // the present loss of the lease has raised its floor
  std::deque<int64_t> floor_raises_ns_;
  uint64_t lease_term_ = 0;
  int64_t lease_end_ns_ = 0;
  int64_t newest_echo_ns_ = 0;
  std::optional<int64_t> live_since_ns_;  // lease of highest_term_, without a gap
  bool evidence_complete_ = false;

  std::optional<Job> job_;
  uint64_t attempt_ = 0;
  std::optional<uint64_t> survey_attempt_;  // until its outcome has come
  int64_t survey_end_ns_ = 0;
  int recorded_target_ = -1;  // when the survey began
  int position_ = -1;         // level whose enter steps began last; -1 = none yet
  int entered_from_ = -1;     // the position before that
  bool verified_ = false;
  std::string observed_;
  int64_t next_check_ns_ = 0;
  int64_t retry_at_ns_ = 0;
  int64_t retry_delay_ns_ = 0;
  uint64_t drifts_ = 0;
  DriftWatch drift_watch_;  // of the level that was entered last
  DropWatch drop_watch_;    // of the same
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_LEVEL_CONTROLLER_H_
