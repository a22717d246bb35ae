// An end of waiting, by a clock that does not jump.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_DEADLINE_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_DEADLINE_H_

#include <algorithm>
#include <chrono>
#include <cstdint>

#include "absl/time/time.h"

namespace rips::outputs {

class Deadline {
 public:
  explicit Deadline(absl::Duration within)
      : end_(std::chrono::steady_clock::now() + absl::ToChronoNanoseconds(within)) {}

  // Not negative.
  absl::Duration left() const {
    return std::max(absl::FromChrono(end_ - std::chrono::steady_clock::now()),
                    absl::ZeroDuration());
  }
  // For poll(); 0 only when it has passed.
  int poll_ms() const {
    return static_cast<int>(absl::ToInt64Milliseconds(absl::Ceil(left(), absl::Milliseconds(1))));
  }

 private:
  std::chrono::steady_clock::time_point end_;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_DEADLINE_H_
