// The level of one robot and the rules of its change. Pure: time is an argument.
//
// Request (a rule's trigger), by where `to` lies relative to the current level:
//
//   to            current soft   current hard
//   above         decided        decided
//   equal         unchanged      unchanged
//   one below     decided*       refused kNeedsOperator
//   further below refused kNeedsOperator
//
//   * unless late (kLate), blind (kBlind) or out of budget (kBudget), checked in this order.
//   A level that is not in the table is refused kUnexpected.
//
// Invariants, whatever the order of calls:
//   1. The level goes down only by a Request from a soft level to the next one below, timely, with
//      complete evidence and budget left, or by a DeEscalate that names the current level and
//      decision id.
//   2. Every decision has a decision id of its own: its epoch is above every epoch used or adopted
//      before, its term is not below any before.
//   3. A refusal, and a request of the current level, change neither level nor decision id.
//   4. While soft lowerings are suspended no Request lowers; only Resume() ends that.
//   5. Rules lower at most `lowerings_max` times in any `window_ns` without a Resume(), over
//      restarts, too, if RestoreBudget is given the times of before.
#ifndef RIPS_POLICY_SERVER_POLICY_LEVELS_LEVEL_MACHINE_H_
#define RIPS_POLICY_SERVER_POLICY_LEVELS_LEVEL_MACHINE_H_

#include <cstdint>
#include <deque>
#include <string>
#include <vector>

#include "policy_server/policy/levels/level_table.h"
#include "policy_server/policy/levels/transition.h"
#include "services/base/clock.h"
#include "services/base/decision_id.h"

namespace rips::levels {

struct SoftBudget {
  // At most this many soft lowerings within `window_ns`; one more suspends them until Resume().
  int lowerings_max = 3;
  int64_t window_ns = 600 * kNanosPerSecond;
};

// Why a soft lowering must wait; empty = evidence has been complete for soft_hold.
struct Evidence {
  std::vector<std::string> blind_because;
};

enum class Lateness { kTimely, kLate };

// Not thread-safe.
class LevelMachine {
 public:
  // Terms and epochs that a robot shows are believed up to here, so that none can use up all
  // decision ids.
  static constexpr uint64_t kCounterMax = uint64_t{1} << 62;

  // `level` must be in `table`. `decision_id` names the decision that led to it (none = never
  // decided). New decisions take `term`, which must be >= decision id.term, and epochs above
  // decision id.epoch.
  LevelMachine(LevelTable table, LevelIndex level, DecisionId decision_id, uint64_t term,
               SoftBudget budget = {});

  // A rule's trigger(to).
  Transition Request(LevelIndex to, const Cause& cause, Instant now, const Evidence& evidence,
                     Lateness lateness);
  // A rule gave up: the last level, whatever the current one is.
  Transition Crash(const Cause& cause, Instant now);
  // An operator's decisions. `expected_*` is what the operator saw. The caller has authenticated
  // the operator and checked the reason.
  Transition Raise(LevelIndex to, const Cause& cause, Instant now);
  Transition DeEscalate(LevelIndex to, const Cause& cause, Instant now, LevelIndex expected_level,
                        const DecisionId& expected_decision_id);
  // The robot holds `level` under a decision id unknown here: takes the more restrictive of both,
  // always as a new decision above `seen` (cut to kCounterMax). The caller has drawn a term that is
  // not below that of `seen`: a term that the store never gave could be another server's. A level
  // that is not in the table counts as the last one.
  Transition Adopt(LevelIndex level, const DecisionId& seen, Instant now);
  // The same level as a new decision, so that it stands in the newest term.
  Transition Reaffirm(const Cause& cause, Instant now);
  // A Hello showed a term above ours: later decisions use at least `term` (cut to kCounterMax).
  void RaiseTerm(uint64_t term);
  // Suspends soft lowerings, as they were before a restart.
  void Suspend() { suspended_ = true; }
  // What was spent of the budget before a restart: when levels were lowered, CLOCK_BOOTTIME (before
  // the host's start it is negative), oldest first. `resumed_at`: see there.
  void RestoreBudget(const std::vector<int64_t>& lowered_at_ns, const DecisionId& resumed_at);
  // Ends the suspension of soft lowerings and gives the whole budget back.
  void Resume();

  // Another policy: the level is kept by name. False (and nothing changes) if `table` lacks it.
  bool SwapTable(LevelTable table);

  const LevelTable& table() const { return table_; }
  LevelIndex level() const { return level_; }
  const DecisionId& decision_id() const { return decision_id_; }
  uint64_t term() const { return term_; }
  bool soft_suspended() const { return suspended_; }
  // The decision that stood when the whole budget was given back last; none = never. Lowerings up
  // to that one do not count.
  const DecisionId& resumed_at() const { return resumed_at_; }

 private:
  Transition Propose(LevelIndex to, const Cause& cause, Instant now) const;
  Transition Decide(Transition transition);
  // Takes one soft lowering from the budget; false (and suspended) if there is none left.
  bool SpendBudget(Instant now);

  LevelTable table_;
  LevelIndex level_;
  DecisionId decision_id_;
  uint64_t term_;
  // Highest epoch ever used; the next decision takes the one after.
  uint64_t epoch_;
  SoftBudget budget_;
  std::deque<int64_t> lowered_at_ns_;
  bool suspended_ = false;
  DecisionId resumed_at_;
};

}  // namespace rips::levels

#endif  // RIPS_POLICY_SERVER_POLICY_LEVELS_LEVEL_MACHINE_H_
