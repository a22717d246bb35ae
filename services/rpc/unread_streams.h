// Limits of what the server keeps for peers that do not read, and what is said when one is hit.
//
// | kind     | a stream holds at most | all of the kind together | what it carries             |
// |----------|------------------------|--------------------------|-----------------------------|
// | record   | 16 MiB                 | 64 MiB                   | recordings, with payloads   |
// | watch    | 8 MiB                  | 64 MiB                   | robots' states, alerts      |
// | sensor   | 8 MiB                  | 256 MiB                  | interest, acknowledgements  |
// | actuator | 4 MiB                  | 128 MiB                  | commands, leases            |
//
// In memory, not on the wire; the library holds one serialized message of each stream besides. A
// limit that is hit ends a stream (StreamOutbound, SendBudget), is counted in
// rips_streams_unread_total, and is an alert that names the peer's identity and address, at most
// once a minute for each identity.
#ifndef RIPS_SERVICES_RPC_UNREAD_STREAMS_H_
#define RIPS_SERVICES_RPC_UNREAD_STREAMS_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>

#include "absl/base/thread_annotations.h"
#include "services/base/clock.h"
#include "services/rpc/peer.h"
#include "services/rpc/send_budget.h"
#include "services/rpc/stream_outbound.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

enum class StreamKind { kRecord, kWatch, kSensor, kActuator };
inline constexpr size_t kStreamKinds = 4;

struct UnreadLimits {
  size_t stream_bytes = 0;
  size_t all_bytes = 0;
};
UnreadLimits UnreadLimitsOf(StreamKind kind);

// Any thread. Outlives the streams that have its limits.
class UnreadStreams {
 public:
  // Identities whose last alert is remembered; of others there is no alert for a minute.
  static constexpr size_t kToldMax = 256;
  static constexpr int64_t kTellEveryNs = 60 * kNanosPerSecond;

  // `alert` is called without a lock and must not block. Nothing is owned.
  UnreadStreams(const Clock* clock, Metrics* metrics, std::function<void(const std::string&)> alert,
                UnreadLimits (*limits)(StreamKind) = UnreadLimitsOf);

  // For a stream of `peer`, which is at `address`.
  OutboundLimits LimitsFor(StreamKind kind, const Peer& peer, const std::string& address);

 private:
  void OnExceeded(StreamKind kind, const std::string& who, const std::string& address,
                  const std::string& why) ABSL_LOCKS_EXCLUDED(mu_);

  const Clock* clock_;
  const std::function<void(const std::string&)> alert_;
  UnreadLimits (*const limits_)(StreamKind);
  std::array<std::shared_ptr<SendBudget>, kStreamKinds> budgets_;
  std::array<Counter, kStreamKinds> counts_;
  Mutex mu_;
  // By identity; CLOCK_BOOTTIME.
  std::map<std::string, int64_t> told_ns_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_UNREAD_STREAMS_H_
