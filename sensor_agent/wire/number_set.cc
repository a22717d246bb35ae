#include "sensor_agent/wire/number_set.h"

#include <algorithm>

namespace rips::wire {

bool NumberSet::Add(NumberRun run) {
  if (run.last < run.first) return true;
  if (!runs_.empty()) {
    // The usual ones: the next number, or one of those that came last.
    NumberRun& newest = runs_.back();
    if (newest.first <= run.first && run.last <= newest.last) return true;
    if (runs_.size() == 1 && newest.last + 1 == run.first) {
      newest.last = run.last;
      return true;
    }
  }
  // It takes in those that it meets.
  const auto met = std::remove_if(runs_.begin(), runs_.end(), [&run](const NumberRun& each) {
    if (each.last + 1 < run.first || run.last + 1 < each.first) return false;
    run = {.first = std::min(run.first, each.first), .last = std::max(run.last, each.last)};
    return true;
  });
  runs_.erase(met, runs_.end());
  if (runs_.size() >= runs_max_) {
    ++overflows_;
    if (keep_) return false;
    runs_.erase(runs_.begin());
  }
  runs_.push_back(run);
  return true;
}

uint64_t NumberSet::count() const {
  uint64_t count = 0;
  for (const NumberRun& each : runs_) count += each.last - each.first + 1;
  return count;
}

uint64_t NumberSet::CountIn(const NumberRun& run) const {
  uint64_t count = 0;
  for (const NumberRun& each : runs_) {
    const uint64_t first = std::max(each.first, run.first);
    const uint64_t last = std::min(each.last, run.last);
    if (first <= last) count += last - first + 1;
  }
  return count;
}

std::vector<NumberRun> NumberSet::Without(const NumberRun& run) const {
  std::vector<NumberRun> sorted = runs_;
  std::sort(sorted.begin(), sorted.end(),
            [](const NumberRun& a, const NumberRun& b) { return a.first < b.first; });
  std::vector<NumberRun> parts;
  uint64_t next = run.first;
  for (const NumberRun& each : sorted) {
    if (each.last < next || each.first > run.last) continue;
    if (next < each.first) parts.push_back({.first = next, .last = each.first - 1});
    next = each.last + 1;
  }
  if (next <= run.last) parts.push_back({.first = next, .last = run.last});
  return parts;
}

}  // namespace rips::wire
