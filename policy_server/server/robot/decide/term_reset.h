// Terms and epochs that an actuator shows and that are far beyond ours. Pure.
//
// A hello with such a number is refused: a stolen key, or a damaged state file, must not use up all
// terms. It may be right all the same: the state file was damaged upward, or the server's store was
// replaced by a new one. Then an administrator lets the server go above it, once:
//
//   what the hello shows                  verdict         what brings both together
//   a term up to 2^20 above ours          kNear           nothing: the server goes above it
//   a higher one, or an epoch above 2^40  kFar            `ripsctl agent reset-term`
//   a higher one above 2^61               kOutOfReach     removing the state file on the host: no
//                                                         term would be left above it
//
// A reset lowers nothing: the robot's level is decided anew, as it is, in the higher term, and what
// the actuator holds by then is adopted if it is more restrictive.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_TERM_RESET_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_TERM_RESET_H_

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>

#include "services/base/decision_id.h"

namespace rips::pipeline {

// A restored store lacks a few terms, another fleet's actuator some thousands.
inline constexpr uint64_t kTermJumpMax = uint64_t{1} << 20;
inline constexpr uint64_t kEpochMax = uint64_t{1} << 40;
// Half of LevelMachine::kCounterMax: a reset leaves room for as many terms again.
inline constexpr uint64_t kTermResetMax = uint64_t{1} << 61;

// What a refused hello showed.
struct ShownTerm {
  DecisionId decision_id;
  uint64_t highest_term = 0;

  uint64_t term() const { return std::max(highest_term, decision_id.term); }
  friend bool operator==(const ShownTerm&, const ShownTerm&) = default;
};

enum class TermJump { kNear, kFar, kOutOfReach };

// `pardoned`: what an administrator let the server go above; none = nothing.
// `ours`: the newest decision, of which the epoch is never far, and the term in use.
inline TermJump JudgeTerm(const ShownTerm& shown, const DecisionId& ours,
                          const std::optional<ShownTerm>& pardoned) {
  const uint64_t our_term = ours.term;
  if (shown.term() > our_term + kTermJumpMax) {
    return shown.term() > kTermResetMax ? TermJump::kOutOfReach : TermJump::kFar;
  }
  // Of a pardoned decision, the epoch does not count: it stands in a lower term.
  const bool epoch_counts = !(pardoned == shown && shown.term() < our_term);
  const bool far = epoch_counts && shown.decision_id.epoch > std::max(kEpochMax, ours.epoch);
  return far ? TermJump::kFar : TermJump::kNear;
}

// What an administrator can do about it.
inline std::string TermRemedy(TermJump jump, const std::string& robot, const std::string& host) {
  if (jump == TermJump::kOutOfReach) {
    return "no term can be above that: on " + host +
           ", stop rips-actuator, remove its state file and start it again; it looks at its robot "
           "then, and begins at its fail-safe level or what it finds, whichever is higher";
  }
  return "if its state was damaged, or the server's store is a new one, `ripsctl agent "
         "reset-term " +
         robot + " " + host + " --reason TEXT` lets the server go above it";
}

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_TERM_RESET_H_
