// What one connection may cost: bytes that it sends without anything coming of them, and calls.
// Bytes of an endless header block, of streams that are opened and reset, of pings and settings
// reach no handler; this library version holds them without bound. Pure: no sockets, no clock.
//
// | the connection                                                       | is ended as       |
// |----------------------------------------------------------------------|-------------------|
// | has made no call for `silent_ns` from its start                      | kSilent           |
// | is not identified and has sent `unidentified_bytes` more than its    | kBytes            |
// | calls account for, `idle_bytes_per_second` being free                |                   |
// | begins more calls than `calls_burst` at once, or than                | kCalls            |
// | `calls_per_second`                                                   |                   |
// | is identified, and has sent `ahead_bytes` (of an operator:           | kBytes            |
// | `operator_ahead_bytes`) more than its messages and calls account for |                   |
// | has sent a message that a handler refused: ours never do             | kRefused          |
// | began calls with a certificate that began too many on all its        | kCalls            |
// | connections together (ConnectionGuard)                               |                   |
#ifndef RIPS_SERVICES_RPC_CONNECTION_BUDGET_H_
#define RIPS_SERVICES_RPC_CONNECTION_BUDGET_H_

#include <cstddef>
#include <cstdint>

#include "absl/strings/string_view.h"
#include "services/base/clock.h"

namespace rips::rpc {

struct BudgetLimits {
  int64_t silent_ns = 15 * kNanosPerSecond;
  double unidentified_bytes = 64 << 10;
  double calls_burst = 100;
  double calls_per_second = 20;
  // What the kernel and the library hold of a peer that is not read for a while.
  double ahead_bytes = 24 << 20;
  // More than the longest message.
  double operator_ahead_bytes = 6 << 20;
  double idle_bytes_per_second = 4'096;
};

enum class Excess { kNone, kSilent, kCalls, kBytes, kRefused };
absl::string_view ToString(Excess excess);

// Not thread-safe; times are CLOCK_BOOTTIME.
class ConnectionBudget {
 public:
  ConnectionBudget(const BudgetLimits& limits, int64_t opened_ns)
      : limits_(limits),
        opened_ns_(opened_ns),
        looked_ns_(opened_ns),
        call_ns_(opened_ns),
        ahead_max_(limits.unidentified_bytes),
        tokens_(limits.calls_burst) {}

  // A call begins: kNone or kCalls.
  Excess OnCall(int64_t now_ns);
  // A call was admitted: the peer's certificate is one of ours.
  void OnIdentified(bool agent) {
    ahead_max_ = agent ? limits_.ahead_bytes : limits_.operator_ahead_bytes;
  }
  // Found by others.
  void Exceed(Excess why) { exceeded_ = why; }
  Excess exceeded() const { return exceeded_; }
  // A handler has received a message of so many bytes.
  void OnMessage(size_t bytes);
  // `received_bytes`: all that came on the connection since its start, TLS included.
  Excess Check(uint64_t received_bytes, int64_t now_ns);

  uint64_t calls() const { return calls_; }

 private:
  const BudgetLimits limits_;
  const int64_t opened_ns_;
  int64_t looked_ns_;
  int64_t call_ns_;
  double ahead_max_;
  double tokens_;
  uint64_t calls_ = 0;
  Excess exceeded_ = Excess::kNone;
  uint64_t received_bytes_ = 0;
  // Bytes that are not accounted for.
  double ahead_ = 0;
  // Accounted for since the last look.
  double accounted_ = 0;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_CONNECTION_BUDGET_H_
