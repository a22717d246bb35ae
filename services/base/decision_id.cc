#include "services/base/decision_id.h"

#include <vector>

#include "absl/status/status.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace rips {

std::string ToString(const DecisionId& decision_id) {
  return absl::StrCat(decision_id.term, ".", decision_id.epoch);
}

absl::StatusOr<DecisionId> ParseDecisionId(absl::string_view text) {
  const std::vector<absl::string_view> parts = absl::StrSplit(text, '.');
  DecisionId decision_id;
  if (parts.size() != 2 || !absl::SimpleAtoi(parts[0], &decision_id.term) ||
      !absl::SimpleAtoi(parts[1], &decision_id.epoch)) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", text, "` is not a decision; expected TERM.EPOCH, for example 3.17"));
  }
  return decision_id;
}

}  // namespace rips
