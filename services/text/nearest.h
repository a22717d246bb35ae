// Guesses what a mistyped name was meant to be.
#ifndef RIPS_SERVICES_TEXT_NEAREST_H_
#define RIPS_SERVICES_TEXT_NEAREST_H_

#include <string>
#include <vector>

#include "absl/strings/string_view.h"

namespace rips {

// Number of bytes to insert, delete or replace, or of neighbours to swap, to make `b` of `a`; more
// than `limit` may be returned as limit + 1.
int EditDistance(absl::string_view a, absl::string_view b, int limit);

// The candidate at the smallest distance from `name`, at most 2 and less than its length;
// the first of several. Empty if there is none.
absl::string_view Nearest(absl::string_view name, const std::vector<absl::string_view>& candidates);

// "did you mean `X`?", or empty.
std::string NearestHint(absl::string_view name, const std::vector<absl::string_view>& candidates);

}  // namespace rips

#endif  // RIPS_SERVICES_TEXT_NEAREST_H_
