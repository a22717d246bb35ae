// Faults that do not prevent a level, as the parts of the actuator report them.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_DEGRADED_STATUS_H_
#define RIPS_MODE_ACTUATOR_DECIDE_DEGRADED_STATUS_H_

#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "absl/strings/string_view.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {

// As the heartbeat carries it (actuator.proto).
inline constexpr size_t kDegradedMax = 8;
inline constexpr size_t kDegradedBytesMax = 256;

// `texts`, safe to print and cut to the limits; a cut list says so in its last line.
std::vector<std::string> LimitDegraded(std::vector<std::string> texts);

// Any thread.
class DegradedStatus {
 public:
  // Replaces the report of `source` before.
  void Set(absl::string_view source, std::vector<std::string> texts) ABSL_LOCKS_EXCLUDED(mu_);
  // By source.
  std::vector<std::string> All() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  mutable Mutex mu_;
  absl::btree_map<std::string, std::vector<std::string>> by_source_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_DEGRADED_STATUS_H_
