#include "services/base/mark.h"

#include <vector>

#include "absl/status/status.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"

namespace rips {

std::string ToString(const Mark& mark) { return absl::StrCat(mark.term, ".", mark.epoch); }

absl::StatusOr<Mark> ParseMark(absl::string_view text) {
  const std::vector<absl::string_view> parts = absl::StrSplit(text, '.');
  Mark mark;
  if (parts.size() != 2 || !absl::SimpleAtoi(parts[0], &mark.term) ||
      !absl::SimpleAtoi(parts[1], &mark.epoch)) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", text, "` is not a mark; expected TERM.EPOCH, for example 3.17"));
  }
  return mark;
}

}  // namespace rips
