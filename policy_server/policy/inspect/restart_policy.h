// When a plugin's process may be started again. Back-off is charged to whom it is due: a robot
// whose messages crash a plugin waits alone, so that it cannot make other robots' messages
// unscanned; a process that does not even start makes all wait.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_RESTART_POLICY_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_RESTART_POLICY_H_

#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/container/flat_hash_map.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"

namespace rips::inspect {

struct RestartLimits {
  // After the first failure, doubled by each further one.
  absl::Duration first = absl::Milliseconds(100);
  // A failure later than this after the end of the last wait counts as a first one again.
  absl::Duration longest = absl::Seconds(5);
  // Robots remembered; when there are more, those that may ask again are forgotten, and if that is
  // not enough, all wait as after a failed start.
  size_t robots_max = 1'024;
};

// Times are boottime nanoseconds that never go back. Not thread-safe.
class RestartPolicy {
 public:
  explicit RestartPolicy(RestartLimits limits) : limits_(limits) {}

  // True if a message of `robot` may be shown to the plugin, and start it if need be.
  bool MayAsk(absl::string_view robot, int64_t now_ns) const;
  // The process did not come up, or ended while nobody asked.
  void StartFailed(int64_t now_ns);
  // The process failed on a message of `robot`.
  void AnswerFailed(absl::string_view robot, int64_t now_ns);

 private:
  struct Wait {
    int64_t delay_ns = 0;
    int64_t until_ns = 0;
  };
  void Lengthen(Wait& wait, int64_t now_ns) const;

  RestartLimits limits_;
  Wait start_;
  absl::flat_hash_map<std::string, Wait> robots_;
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_RESTART_POLICY_H_
