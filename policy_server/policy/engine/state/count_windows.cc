#include "policy_server/policy/engine/state/count_windows.h"

#include <algorithm>
#include <iterator>
#include <limits>
#include <utility>

namespace rips::engine {
namespace {

// `time_ns - span_ns`, not below the smallest time.
int64_t Before(int64_t time_ns, int64_t span_ns) {
  constexpr int64_t kMin = std::numeric_limits<int64_t>::min();
  return time_ns < kMin + span_ns ? kMin : time_ns - span_ns;
}

}  // namespace

CountWindows::Window& CountWindows::Find(absl::string_view key) {
  const auto found = windows_.find(key);
  if (found != windows_.end()) return found->second;
  if (windows_.size() >= kKeysMax) ForgetOldest();
  return windows_.emplace(std::string(key), Window()).first->second;
}

void CountWindows::Add(absl::string_view key, int64_t time_ns, int64_t keep_ns) {
  Window& window = Find(key);
  std::vector<Instant>& instants = window.instants;
  if (!instants.empty() && instants.back().time_ns >= time_ns) {
    ++instants.back().total;
    return;
  }
  if (instants.size() >= kInstantsMax) Shorten(window, time_ns, keep_ns);
  const uint64_t total = instants.empty() ? window.forgotten : instants.back().total;
  instants.push_back({.time_ns = time_ns, .total = total + 1});
}

void CountWindows::AddLost(absl::string_view key, uint64_t count, int64_t first_ns, int64_t last_ns,
                           int64_t keep_ns) {
  if (count == 0) return;
  const uint64_t span_ns = static_cast<uint64_t>(last_ns) - static_cast<uint64_t>(first_ns);
  const uint64_t parts = span_ns == 0 ? 1 : std::min(count, kSpreadMax);
  // What each instant adds, the lost ones among them.
  std::vector<Instant> added;
  added.reserve(parts);
  uint64_t before = 0;
  for (uint64_t i = 1; i <= parts; ++i) {
    const uint64_t rest_ns = span_ns / parts * (parts - i);
    const uint64_t upto = count / parts * i + count % parts * i / parts;
    added.push_back({static_cast<int64_t>(static_cast<uint64_t>(last_ns) - rest_ns),
                     upto - std::exchange(before, upto)});
  }

  Window& window = Find(key);
  std::vector<Instant> merged;
  merged.reserve(window.instants.size() + added.size());
  uint64_t total = window.forgotten;
  for (Instant& instant : window.instants) instant.total -= std::exchange(total, instant.total);
  std::merge(window.instants.begin(), window.instants.end(), added.begin(), added.end(),
             std::back_inserter(merged),
             [](const Instant& a, const Instant& b) { return a.time_ns < b.time_ns; });
  total = window.forgotten;
  for (Instant& instant : merged) instant.total = total += instant.total;
  window.instants = std::move(merged);
  if (window.instants.size() > kInstantsMax) {
    Shorten(window, window.instants.back().time_ns, keep_ns);
  }
}

uint64_t CountWindows::Count(absl::string_view key, int64_t now_ns, int64_t window_ns) const {
  const auto found = windows_.find(key);
  if (found == windows_.end() || found->second.instants.empty()) return 0;
  const std::vector<Instant>& instants = found->second.instants;
  const int64_t oldest_ns = Before(now_ns, window_ns);
  const auto first = std::upper_bound(
      instants.begin(), instants.end(), oldest_ns,
      [](int64_t time_ns, const Instant& instant) { return time_ns < instant.time_ns; });
  const uint64_t before =
      first == instants.begin() ? found->second.forgotten : std::prev(first)->total;
  return instants.back().total - before;
}

void CountWindows::Shorten(Window& window, int64_t now_ns, int64_t keep_ns) {
  std::vector<Instant>& instants = window.instants;
  const auto kept = std::upper_bound(
      instants.begin(), instants.end(), Before(now_ns, keep_ns),
      [](int64_t time_ns, const Instant& instant) { return time_ns < instant.time_ns; });
  if (kept != instants.begin()) {
    window.forgotten = std::prev(kept)->total;
    instants.erase(instants.begin(), kept);
  }
  // Room enough for now.
  if (instants.size() < kExactMax) return;
  // The latest of each cell of time stands for all of it. The newest instant keeps its time.
  const int64_t cell_ns = std::max<int64_t>(1, keep_ns / (kInstantsMax / 2));
  size_t to = 0;
  for (const Instant& instant : instants) {
    if (to > 0 && instants[to - 1].time_ns / cell_ns == instant.time_ns / cell_ns) --to;
    instants[to++] = instant;
  }
  instants.resize(to);
}

void CountWindows::ForgetOldest() {
  const auto oldest =
      std::min_element(windows_.begin(), windows_.end(), [](const auto& a, const auto& b) {
        return a.second.instants.back().time_ns < b.second.instants.back().time_ns;
      });
  if (oldest != windows_.end()) windows_.erase(oldest);
}

}  // namespace rips::engine
