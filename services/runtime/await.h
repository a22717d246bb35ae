// Waits for what is not an error of the configuration but of the moment: a file that comes late, a
// certificate that is not valid yet by a wrong clock.
#ifndef RIPS_SERVICES_RUNTIME_AWAIT_H_
#define RIPS_SERVICES_RUNTIME_AWAIT_H_

#include <cstdint>
#include <functional>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"

namespace rips {

// Lets a message pass if it differs from the last one, or that is 10 minutes old. One thread at a
// time.
class RepeatFilter {
 public:
  static constexpr absl::Duration kAgain = absl::Minutes(10);

  // True: say it. By CLOCK_BOOTTIME.
  bool Pass(absl::string_view message, int64_t now_boottime_ns);
  // Something was said since the last Clear.
  bool said() const { return !last_.empty(); }
  void Clear() { last_.clear(); }

 private:
  std::string last_;
  int64_t again_ns_ = 0;
};

// Calls `attempt` until it is OK or PermissionDenied, which no waiting mends, and returns that.
// Between attempts calls `pause` with 1 s, doubled to 10 s; true from it ends the wait with
// Cancelled. Logs `waiting for WHAT` with the reason as RepeatFilter lets it, and the end.
absl::Status Await(absl::string_view what, const std::function<absl::Status()>& attempt,
                   const std::function<bool(absl::Duration)>& pause);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_AWAIT_H_
