// The name of one level decision of one robot.
#ifndef RIPS_SERVICES_BASE_DECISION_ID_H_
#define RIPS_SERVICES_BASE_DECISION_ID_H_

#include <compare>
#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips {

// Ordered by term, then epoch. {0, 0} means "no decision".
struct DecisionId {
  // The policy server's own counter for this robot, incremented durably at each start or gain of
  // ownership. It fences: an actuator refuses a command of a lower term than the highest it saw.
  uint64_t term = 0;
  // Counts decisions of the robot, from 1; never reused, also not across terms.
  uint64_t epoch = 0;

  friend auto operator<=>(const DecisionId&, const DecisionId&) = default;
  bool none() const { return term == 0 && epoch == 0; }
};

// "term.epoch", both decimal.
std::string ToString(const DecisionId& decision_id);

// Inverse of ToString; InvalidArgument for anything else.
absl::StatusOr<DecisionId> ParseDecisionId(absl::string_view text);

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_DECISION_ID_H_
