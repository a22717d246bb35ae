// Counts how often the level that is held was found left, and says when its `on_drift` steps are
// due: at the kDriftsMax-th time within kDriftWindowNs, after the level was ordered again, and once
// in that time. Pure; used by one thread, times are CLOCK_BOOTTIME nanoseconds.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_DRIFT_WATCH_H_
#define RIPS_MODE_ACTUATOR_DECIDE_DRIFT_WATCH_H_

#include <cstdint>
#include <deque>
#include <optional>
#include <string>

#include "absl/strings/string_view.h"
#include "services/base/clock.h"

namespace rips::actuator {

inline constexpr int64_t kDriftWindowNs = 60 * kNanosPerSecond;
inline constexpr int kDriftsMax = 3;

class DriftWatch {
 public:
  // Another level is entered: nothing is known of it.
  void Reset();
  // The level was found left.
  void Left(int64_t now_ns);
  // The on_drift steps have begun, or there are none. False if they are not due.
  bool PopDue(int64_t now_ns);
  // What came of them. `failure` is empty if all is well.
  void Ran(absl::string_view failure);

  // A message, empty while the level is not left too often: `ALERT was left 3 times in 60 s; its
  // on_drift steps were run`.
  std::string Degraded(absl::string_view level, int64_t now_ns) const;

 private:
  int Recent(int64_t now_ns) const;

  std::deque<int64_t> left_ns_;  // oldest first; of the window
  std::optional<int64_t> popped_ns_;
  bool due_ = false;
  std::string what_followed_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_DRIFT_WATCH_H_
