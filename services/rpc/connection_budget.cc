#include "services/rpc/connection_budget.h"

#include <algorithm>

namespace rips::rpc {
namespace {

// Of one message beside its bytes: frames of HTTP/2 and TLS.
constexpr double kMessageBytes = 64;
// TLS and HTTP/2 frames of a long message.
constexpr double kFraming = 1.05;
// Headers of one call.
constexpr double kCallBytes = 1'024;
// A message may be accounted for just before its last bytes are counted as received.
constexpr double kEarlyBytes = 256 << 10;

}  // namespace

absl::string_view ToString(Excess excess) {
  switch (excess) {
    case Excess::kNone:
      return "none";
    case Excess::kSilent:
      return "silent";
    case Excess::kCalls:
      return "calls";
    case Excess::kBytes:
      return "bytes";
    case Excess::kRefused:
      return "refused";
  }
  return "unknown";
}

Excess ConnectionBudget::OnCall(int64_t now_ns) {
  const double seconds = static_cast<double>(now_ns - call_ns_) / kNanosPerSecond;
  call_ns_ = now_ns;
  tokens_ = std::min(limits_.calls_burst, tokens_ + seconds * limits_.calls_per_second);
  ++calls_;
  accounted_ += kCallBytes;
  if (tokens_ < 1) return Excess::kCalls;
  tokens_ -= 1;
  return Excess::kNone;
}

void ConnectionBudget::OnMessage(size_t bytes) {
  accounted_ += kFraming * static_cast<double>(bytes) + kMessageBytes;
}

Excess ConnectionBudget::Check(uint64_t received_bytes, int64_t now_ns) {
  const double seconds = static_cast<double>(now_ns - looked_ns_) / kNanosPerSecond;
  const uint64_t came = std::max(received_bytes, received_bytes_) - received_bytes_;
  looked_ns_ = now_ns;
  received_bytes_ += came;
  // What was accounted for yesterday is no credit for today.
  ahead_ = std::max(-kEarlyBytes, ahead_ + static_cast<double>(came) - accounted_ -
                                      seconds * limits_.idle_bytes_per_second);
  accounted_ = 0;
  if (ahead_ > ahead_max_) return Excess::kBytes;
  const bool silent = calls_ == 0 && now_ns - opened_ns_ > limits_.silent_ns;
  return silent ? Excess::kSilent : Excess::kNone;
}

}  // namespace rips::rpc
