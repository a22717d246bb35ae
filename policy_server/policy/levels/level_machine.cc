#include "policy_server/policy/levels/level_machine.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/base/check.h"

namespace rips::levels {
namespace {

Transition Refused(Transition transition, Refusal refusal, std::string detail) {
  transition.refusal = refusal;
  transition.detail = std::move(detail);
  return transition;
}

}  // namespace

LevelMachine::LevelMachine(LevelTable table, LevelIndex level, DecisionId decision_id,
                           uint64_t term, SoftBudget budget)
    : table_(std::move(table)),
      level_(level),
      decision_id_(decision_id),
      term_(term),
      epoch_(decision_id.epoch),
      budget_(budget) {
  RIPS_CHECK(table_.contains(level_), "the level must be in the table");
  RIPS_CHECK(term_ >= decision_id_.term, "the term must not be below that of the last decision");
}

Transition LevelMachine::Propose(LevelIndex to, const Cause& cause, Instant now) const {
  return {.from = level_, .to = to, .based_on = decision_id_, .cause = cause, .at = now};
}

Transition LevelMachine::Decide(Transition transition) {
  decision_id_ = {.term = term_, .epoch = ++epoch_};
  level_ = transition.to;
  transition.decision_id = decision_id_;
  return transition;
}

Transition LevelMachine::Request(LevelIndex to, const Cause& cause, Instant now,
                                 const Evidence& evidence, Lateness lateness) {
  Transition proposed = Propose(to, cause, now);
  if (!table_.contains(to)) {
    return Refused(std::move(proposed), Refusal::kUnexpected, absl::StrCat("no level ", to));
  }
  if (to == level_) return proposed;
  if (to > level_) return Decide(std::move(proposed));
  if (!table_.at(level_).soft) {
    return Refused(std::move(proposed), Refusal::kNeedsOperator,
                   absl::StrCat("`", table_.name(level_), "` is not soft"));
  }
  if (to != level_ - 1) {
    return Refused(
        std::move(proposed), Refusal::kNeedsOperator,
        absl::StrCat("`", table_.name(to), "` is more than one below `", table_.name(level_), "`"));
  }
  if (lateness == Lateness::kLate) {
    return Refused(std::move(proposed), Refusal::kLate, "the event was judged late");
  }
  if (!evidence.blind_because.empty()) {
    return Refused(std::move(proposed), Refusal::kBlind,
                   absl::StrJoin(evidence.blind_because, ", "));
  }
  if (!SpendBudget(now)) {
    return Refused(std::move(proposed), Refusal::kBudget,
                   absl::StrCat("rules lowered the level ", budget_.lowerings_max, " times within ",
                                budget_.window_ns / (60 * kNanosPerSecond),
                                " minutes; an operator may resume them"));
  }
  return Decide(std::move(proposed));
}

bool LevelMachine::SpendBudget(Instant now) {
  while (!lowered_at_ns_.empty() && now.boottime_ns - lowered_at_ns_.front() >= budget_.window_ns) {
    lowered_at_ns_.pop_front();
  }
  if (static_cast<int64_t>(lowered_at_ns_.size()) >= budget_.lowerings_max) suspended_ = true;
  if (suspended_) return false;
  lowered_at_ns_.push_back(now.boottime_ns);
  return true;
}

Transition LevelMachine::Raise(LevelIndex to, const Cause& cause, Instant now) {
  Transition proposed = Propose(to, cause, now);
  if (!table_.contains(to)) {
    return Refused(std::move(proposed), Refusal::kUnexpected, absl::StrCat("no level ", to));
  }
  if (to <= level_) {
    return Refused(std::move(proposed), Refusal::kNotHigher,
                   to == level_ ? std::string("the robot is there already")
                                : absl::StrCat("`", table_.name(to), "` is below `",
                                               table_.name(level_), "`"));
  }
  return Decide(std::move(proposed));
}

Transition LevelMachine::Crash(const Cause& cause, Instant now) {
  const LevelIndex last = table_.size() - 1;
  Transition proposed = Propose(last, cause, now);
  return last > level_ ? Decide(std::move(proposed)) : proposed;
}

Transition LevelMachine::DeEscalate(LevelIndex to, const Cause& cause, Instant now,
                                    LevelIndex expected_level,
                                    const DecisionId& expected_decision_id) {
  Transition proposed = Propose(to, cause, now);
  if (!table_.contains(to)) {
    return Refused(std::move(proposed), Refusal::kUnexpected, absl::StrCat("no level ", to));
  }
  if (expected_level != level_ || expected_decision_id != decision_id_) {
    return Refused(std::move(proposed), Refusal::kUnexpected,
                   absl::StrCat("the robot is at `", table_.name(level_), "` by decision ",
                                ToString(decision_id_)));
  }
  if (to >= level_) {
    return Refused(std::move(proposed), Refusal::kNotLower,
                   to == level_ ? std::string("the robot is there already")
                                : absl::StrCat("`", table_.name(to), "` is above `",
                                               table_.name(level_), "`"));
  }
  return Decide(std::move(proposed));
}

Transition LevelMachine::Adopt(LevelIndex level, const DecisionId& seen, Instant now) {
  const LevelIndex held = table_.contains(level) ? level : table_.size() - 1;
  const uint64_t seen_term = std::min(seen.term, kCounterMax);
  if (term_ < seen_term) term_ = seen_term + 1;
  epoch_ = std::max(epoch_, std::min(seen.epoch, kCounterMax));
  return Decide(Propose(std::max(level_, held), {.kind = Cause::Kind::kAdopted}, now));
}

Transition LevelMachine::Reaffirm(const Cause& cause, Instant now) {
  return Decide(Propose(level_, cause, now));
}

void LevelMachine::RaiseTerm(uint64_t term) {
  term_ = std::max(term_, std::min(term, kCounterMax));
}

void LevelMachine::RestoreBudget(const std::vector<int64_t>& lowered_at_ns,
                                 const DecisionId& resumed_at) {
  lowered_at_ns_.assign(lowered_at_ns.begin(), lowered_at_ns.end());
  resumed_at_ = resumed_at;
}

void LevelMachine::Resume() {
  suspended_ = false;
  resumed_at_ = decision_id_;
  lowered_at_ns_.clear();
}

bool LevelMachine::SwapTable(LevelTable table) {
  const std::optional<LevelIndex> level = table.Find(table_.name(level_));
  if (!level.has_value()) return false;
  table_ = std::move(table);
  level_ = *level;
  return true;
}

}  // namespace rips::levels
