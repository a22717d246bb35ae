// Transition: what the level machine decided. A refusal is a record too, not an event.
#ifndef RIPS_POLICY_SERVER_POLICY_LEVELS_TRANSITION_H_
#define RIPS_POLICY_SERVER_POLICY_LEVELS_TRANSITION_H_

#include <string>

#include "policy_server/policy/levels/level_table.h"
#include "services/base/clock.h"
#include "services/base/decision_id.h"

namespace rips::levels {

// Who asked.
struct Cause {
  enum class Kind {
    kRule,      // name = rule name
    kOperator,  // name = operator name from the certificate; reason = what they wrote
    kAdopted,   // the robot held a decision that the store did not know
    kCrash,     // the rule action `crash`; name = rule name
  };
  Kind kind = Kind::kRule;
  std::string name;
  std::string reason;

  friend bool operator==(const Cause&, const Cause&) = default;
};

enum class Refusal {
  kNone,
  kNeedsOperator,  // below the current level, which is not soft or not the next one
  kBlind,          // evidence is not complete
  kBudget,         // soft lowerings are suspended until an operator resumes them
  kLate,           // the event was judged late
  kUnexpected,     // the operator expected another level or decision id
  kNotLower,       // DeEscalate to a level that is not below
  kNotHigher,      // Raise to a level that is not above
};

// "needs an operator", "blind", ...; empty for kNone.
absl::string_view ToString(Refusal refusal);

struct Transition {
  LevelIndex from = 0;
  LevelIndex to = 0;
  // Names the new decision; none when refused or unchanged.
  DecisionId decision_id;
  // The decision this one was made on.
  DecisionId based_on;
  Cause cause;
  Refusal refusal = Refusal::kNone;
  // For a refusal, what was missing, for people.
  std::string detail;
  Instant at;

  // A new decision was made. False for a refusal and for a request of the current level.
  bool decided() const { return !decision_id.none(); }
  bool refused() const { return refusal != Refusal::kNone; }
  bool lowers() const { return decided() && to < from; }

  friend bool operator==(const Transition&, const Transition&) = default;
};

}  // namespace rips::levels

#endif  // RIPS_POLICY_SERVER_POLICY_LEVELS_TRANSITION_H_
