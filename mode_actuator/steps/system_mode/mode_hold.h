// How one part came to its mode and who holds it there: whether its mode manager is worth waiting
// for, and which warnings to report. Pure: one thread, times are CLOCK_BOOTTIME nanoseconds.
#ifndef RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MODE_HOLD_H_
#define RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MODE_HOLD_H_

#include <cstdint>
#include <deque>
#include <optional>
#include <string>

#include "absl/strings/string_view.h"
#include "services/base/clock.h"
#include "services/ros2/guid.h"

namespace rips::actuator {

// Times a manager left a mode are counted for so long.
inline constexpr int64_t kLeaveWindowNs = 60 * kNanosPerSecond;
// So many times within the window, and the nodes are ordered without it.
inline constexpr int kLeavesMax = 2;
// Remembered at most.
inline constexpr size_t kLeavesKept = 64;

class ModeHold {
 public:
  explicit ModeHold(std::string part) : part_(std::move(part)) {}

  // Ordered and read back. `without` says why not through the manager; empty = through it. `told`
  // is the manager's endpoint that was told of the mode, if one was.
  void Reached(absl::string_view mode, std::string without, std::optional<ros2::Guid> told);
  // The manager was ordered to the mode held.
  void Notified(const ros2::Guid& manager) { told_ = manager; }
  // The manager agrees: it holds the part again.
  void Agreed() { without_.clear(); }
  // The part is no longer in `mode`, and the manager names `other`.
  void Left(absl::string_view mode, absl::string_view other, int64_t now_ns);
  // The manager is ordered to the mode once per life: true if `manager` was not.
  bool IsNews(const ros2::Guid& manager) const { return told_ != manager; }

  // Held by orders to the nodes: what the manager says does not count.
  bool direct() const { return !without_.empty(); }
  bool holds(absl::string_view mode) const { return mode_ == mode; }
  const std::string& without() const { return without_; }
  // Not empty: why `mode` must be ordered from the nodes without asking the manager.
  std::string WhyNotManager(absl::string_view mode, int64_t now_ns) const;
  // A warning, empty if all is well: `/safety=ALERT is held without the mode manager: ...`.
  std::string Degraded(int64_t now_ns) const;

 private:
  int LeavesOf(absl::string_view mode, int64_t now_ns) const;

  struct Leave {
    int64_t at_ns = 0;
    std::string mode;
    std::string other;
  };

  const std::string part_;
  std::string mode_;  // reached last
  std::string without_;
  std::optional<ros2::Guid> told_;
  std::deque<Leave> leaves_;  // oldest first
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MODE_HOLD_H_
