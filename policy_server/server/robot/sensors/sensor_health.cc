#include "policy_server/server/robot/sensors/sensor_health.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "services/base/saturating.h"

namespace rips::pipeline {
namespace {

// Times of an agent's clock are what it says; sums of them must not overflow.
int64_t Minus(int64_t a, int64_t b) {
  int64_t out = 0;
  if (!__builtin_sub_overflow(a, b, &out)) return out;
  return a < b ? std::numeric_limits<int64_t>::min() : std::numeric_limits<int64_t>::max();
}

}  // namespace

bool ClockSkew::Heartbeat(const SensorHeartbeat& heartbeat, Instant now) {
  const int64_t least_ns = Minus(heartbeat.clock.unix_ns, now.unix_ns);
  lower_bounds_ns_.push_back(least_ns);
  if (lower_bounds_ns_.size() > kHeartbeatsKept) lower_bounds_ns_.pop_front();
  bool behind = false;
  if (heartbeat.echo_boottime_ns > 0 && heartbeat.echo_boottime_ns <= now.boottime_ns) {
    const int64_t round_trip_ns = now.boottime_ns - heartbeat.echo_boottime_ns;
    behind = Minus(least_ns, -round_trip_ns) < -kOffNs;
  }
  const bool off = least_ns > kOffNs || behind;
  heartbeats_off_ = off ? std::min(heartbeats_off_ + 1, kOffHeartbeats) : 0;
  const bool before = std::exchange(off_, heartbeats_off_ >= kOffHeartbeats);
  return off_ && !before;
}

std::optional<int64_t> ClockSkew::estimate_ns() const {
  if (lower_bounds_ns_.empty()) return std::nullopt;
  return *std::max_element(lower_bounds_ns_.begin(), lower_bounds_ns_.end());
}

void BoottimeOffset::Heartbeat(int64_t sent_ns, int64_t now_ns) {
  newest_ns_.push_back(now_ns - sent_ns);
  if (newest_ns_.size() > kHeartbeatsKept) newest_ns_.pop_front();
}

std::optional<int64_t> BoottimeOffset::ns() const {
  if (newest_ns_.empty()) return std::nullopt;
  return *std::min_element(newest_ns_.begin(), newest_ns_.end());
}

bool RestartCount::Began(absl::string_view incarnation, int64_t now_ns) {
  if (last_ == incarnation) return false;
  const bool first = last_.empty();
  last_ = std::string(incarnation);
  if (first || now_ns < std::exchange(expected_until_ns_, 0)) return false;
  while (!restarts_ns_.empty() && now_ns - restarts_ns_.front() >= kWithinNs) {
    restarts_ns_.pop_front();
  }
  restarts_ns_.push_back(now_ns);
  if (restarts_ns_.size() < kRestartsMax) return false;
  restarts_ns_.clear();
  return true;
}

void RecentLosses::Add(uint64_t count, int64_t now_ns) {
  if (count == 0) return;
  const int64_t step_ns = now_ns - now_ns % kStepNs;
  if (steps_.empty() || steps_.back().first < step_ns) steps_.emplace_back(step_ns, 0);
  steps_.back().second = SaturatingAdd(steps_.back().second, count);
  while (now_ns - steps_.front().first >= kWithinNs + kStepNs) steps_.pop_front();
}

uint64_t RecentLosses::Total(int64_t now_ns) const {
  uint64_t total = 0;
  for (const auto& [step_ns, count] : steps_) {
    if (now_ns - step_ns < kWithinNs + kStepNs) total = SaturatingAdd(total, count);
  }
  return total;
}

}  // namespace rips::pipeline
