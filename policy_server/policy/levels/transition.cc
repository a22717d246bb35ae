#include "policy_server/policy/levels/transition.h"

namespace rips::levels {

absl::string_view ToString(Refusal refusal) {
  switch (refusal) {
    case Refusal::kNone:
      return "";
    case Refusal::kNeedsOperator:
      return "needs an operator";
    case Refusal::kBlind:
      return "blind";
    case Refusal::kBudget:
      return "budget";
    case Refusal::kLate:
      return "late";
    case Refusal::kUnexpected:
      return "unexpected";
    case Refusal::kNotLower:
      return "not lower";
    case Refusal::kNotHigher:
      return "not higher";
  }
  return "";
}

}  // namespace rips::levels
