// When to try again after a stream ended. Pure: no clock, no sleeping, randomness comes in.
#ifndef RIPS_SERVICES_RPC_BACKOFF_H_
#define RIPS_SERVICES_RPC_BACKOFF_H_

#include <functional>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"

namespace rips::rpc {

// The n-th delay (from 0) is min(initial * 2^n, max), then multiplied by 1 - jitter .. 1 + jitter.
struct BackoffPolicy {
  absl::Duration initial = absl::Milliseconds(200);
  absl::Duration max = absl::Seconds(5);
  double jitter = 0.2;
};

// An actuator's stays far below its lease: a lease must not expire because of back-off.
inline BackoffPolicy SensorBackoff() { return {}; }
inline BackoffPolicy ActuatorBackoff() { return {.max = absl::Seconds(2)}; }

// A number in [0, 1).
using Random = std::function<double()>;

class Backoff {
 public:
  Backoff(const BackoffPolicy& policy, Random random);
  // The delay before the next attempt.
  absl::Duration Next();
  void Reset() { next_ = policy_.initial; }

 private:
  BackoffPolicy policy_;
  Random random_;
  absl::Duration next_;
};

// What the end of a stream means for the next attempt.
// | class          | status codes                                       | delays                |
// |----------------|----------------------------------------------------|-----------------------|
// | kRetry         | all others, also OK                                | the agent's policy    |
// | kReidentify    | UNAUTHENTICATED: the certificate was not accepted  | the agent's policy    |
// | kSecondSession | ALREADY_EXISTS: an older one is not yet given up   | 1 s, then 2 s         |
// | kRefused       | PERMISSION_DENIED, UNIMPLEMENTED,                  | 1 s doubled to 60 s   |
// |                | FAILED_PRECONDITION, INVALID_ARGUMENT: an error    |                       |
// |                | state, but never the end, else lifting a ban could |                       |
// |                | not work                                           |                       |
enum class CloseClass { kRetry, kReidentify, kSecondSession, kRefused };

CloseClass ClassifyClose(absl::StatusCode code);
// `retry`, `reidentify`, `second_session`, `refused`.
absl::string_view CloseClassName(CloseClass close_class);

// The delays of one agent. Each class doubles on its own; all start again after the first message
// received on a stream (not after connecting: a server that accepts and drops is not hammered).
class ReconnectPacer {
 public:
  ReconnectPacer(const BackoffPolicy& retry, Random random);
  absl::Duration Next(CloseClass close_class);
  void MessageReceived();

 private:
  Backoff retry_;
  Backoff second_session_;
  Backoff refused_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_BACKOFF_H_
