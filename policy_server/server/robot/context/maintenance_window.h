// The time in which the agents of a robot may be away. It changes no decision: alerts of absence
// are less severe in it, and every alert says so.
//
//   Begin                    a new window, in place of the one before
//   End                      no window
//   either clock is at its   over: the wall clock says when it ends, and the monotonic clock of
//   end                      this server's process keeps a wall clock that is set back from making
//                            it longer
//   Restore, after a start   the wall clock decides; one that would end more than 24 h from now
//                            (the clock was set back) is over
//
// Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_MAINTENANCE_WINDOW_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_MAINTENANCE_WINDOW_H_

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "policy_server/server/store/maintenance.h"
#include "services/base/clock.h"

namespace rips::pipeline {

inline constexpr int64_t kMaintenanceNsMin = 60 * kNanosPerSecond;
inline constexpr int64_t kMaintenanceNsMax = 24 * 3'600 * kNanosPerSecond;

// `2026-11-26 18:20:00 UTC`
std::string UtcText(int64_t unix_ns);
// Without the certificate: `carol` of `carol (URI serial NUMBER)`.
std::string ShortName(const std::string& operator_name);
// What alerts say: `in maintenance until 2026-11-26 18:20:00 UTC (asked by carol: reboot)`.
std::string MaintenanceMark(const store::Maintenance& maintenance);

// Not thread-safe.
class MaintenanceWindow {
 public:
  // What the store knows at the start, if any; one that is over is left for PopOver.
  void Restore(const store::Maintenance& stored, const Instant& now);
  // InvalidArgument, and all stays as it is, unless `for_ns` is within kMaintenanceNsMin and
  // kMaintenanceNsMax.
  absl::Status Begin(int64_t for_ns, std::string by, std::string reason, const Instant& now);
  void End() { window_.reset(); }
  // The window that ended by time since the last call, once.
  std::optional<store::Maintenance> PopOver(const Instant& now);

  // The window that holds now.
  std::optional<store::Maintenance> At(const Instant& now) const;
  // Of the window that holds now; empty = none does.
  std::string MarkAt(const Instant& now) const;

 private:
  bool Holds(const Instant& now) const;

  std::optional<store::Maintenance> window_;
  // CLOCK_BOOTTIME.
  int64_t end_ns_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_MAINTENANCE_WINDOW_H_
