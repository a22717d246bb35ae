#include "sensor_agent/messages/seen_numbers.h"

#include <algorithm>

namespace rips::sensor {

bool SeenNumbers::Has(uint64_t number) const {
  const auto after = std::upper_bound(ranges_.begin(), ranges_.end(), number,
                                      [](uint64_t n, const Range& each) { return n < each.first; });
  return after != ranges_.begin() && number <= std::prev(after)->last;
}

bool SeenNumbers::Add(uint64_t number) {
  if (Has(number)) return false;
  // The usual case.
  if (!ranges_.empty() && number == ranges_.back().last + 1) {
    ranges_.back().last = number;
    return true;
  }
  auto at = std::upper_bound(ranges_.begin(), ranges_.end(), number,
                             [](uint64_t n, const Range& each) { return n < each.first; });
  const bool joins_next = at != ranges_.end() && at->first == number + 1;
  if (at != ranges_.begin() && std::prev(at)->last + 1 == number) {
    std::prev(at)->last = joins_next ? at->last : number;
    if (joins_next) ranges_.erase(at);
    return true;
  }
  if (joins_next) {
    at->first = number;
    return true;
  }
  ranges_.insert(at, {number, number});
  if (ranges_.size() <= kRanges) return true;
  size_t least = 1;
  const auto gap = [&](size_t i) { return ranges_[i].first - ranges_[i - 1].last; };
  for (size_t i = 2; i < ranges_.size(); ++i) {
    if (gap(i) < gap(least)) least = i;
  }
  if (gap(least) <= kSmallGap) {
    ranges_[least - 1].last = ranges_[least].last;
    ranges_.erase(ranges_.begin() + static_cast<std::ptrdiff_t>(least));
  } else {
    ranges_.erase(ranges_.begin());
  }
  return true;
}

}  // namespace rips::sensor
