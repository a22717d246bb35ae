#include "services/text/nearest.h"

#include <algorithm>
#include <cstdlib>

#include "absl/strings/str_cat.h"
#include "services/text/quote.h"
#include "services/text/utf8.h"

namespace rips {
namespace {

constexpr int kDistanceMax = 2;

}  // namespace

int EditDistance(absl::string_view a, absl::string_view b, int limit) {
  const int size_difference = std::abs(static_cast<int>(a.size()) - static_cast<int>(b.size()));
  if (size_difference > limit) return limit + 1;
  std::vector<int> before(b.size() + 1);
  std::vector<int> above(b.size() + 1);
  std::vector<int> row(b.size() + 1);
  for (size_t j = 0; j <= b.size(); ++j) row[j] = static_cast<int>(j);
  for (size_t i = 1; i <= a.size(); ++i) {
    before.swap(above);
    above.swap(row);
    row[0] = static_cast<int>(i);
    for (size_t j = 1; j <= b.size(); ++j) {
      const int replace = above[j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1);
      row[j] = std::min({above[j] + 1, row[j - 1] + 1, replace});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1]) {
        row[j] = std::min(row[j], before[j - 2] + 1);
      }
    }
  }
  return row[b.size()];
}

absl::string_view Nearest(absl::string_view name,
                          const std::vector<absl::string_view>& candidates) {
  absl::string_view best;
  int best_distance = kDistanceMax + 1;
  for (const absl::string_view candidate : candidates) {
    const int distance = EditDistance(name, candidate, kDistanceMax);
    if (distance < best_distance && distance < static_cast<int>(name.size())) {
      best = candidate;
      best_distance = distance;
    }
  }
  return best;
}

std::string NearestHint(absl::string_view name, const std::vector<absl::string_view>& candidates) {
  const absl::string_view nearest = Nearest(name, candidates);
  return nearest.empty() ? "" : absl::StrCat("did you mean ", Quote(nearest), "?");
}

}  // namespace rips
