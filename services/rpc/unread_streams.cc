#include "services/rpc/unread_streams.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/runtime/log.h"

namespace rips::rpc {
namespace {

constexpr size_t kMiB = size_t{1} << 20;
constexpr std::array<const char*, kStreamKinds> kNames = {"record", "watch", "sensor", "actuator"};

size_t Index(StreamKind kind) { return static_cast<size_t>(kind); }

}  // namespace

UnreadLimits UnreadLimitsOf(StreamKind kind) {
  switch (kind) {
    case StreamKind::kRecord:
      return {.stream_bytes = 16 * kMiB, .all_bytes = 64 * kMiB};
    case StreamKind::kWatch:
      return {.stream_bytes = 8 * kMiB, .all_bytes = 64 * kMiB};
    case StreamKind::kSensor:
      return {.stream_bytes = 8 * kMiB, .all_bytes = 256 * kMiB};
    case StreamKind::kActuator:
      return {.stream_bytes = 4 * kMiB, .all_bytes = 128 * kMiB};
  }
  return {};
}

UnreadStreams::UnreadStreams(const Clock* clock, Metrics* metrics,
                             std::function<void(const std::string&)> alert,
                             UnreadLimits (*limits)(StreamKind))
    : clock_(clock), alert_(std::move(alert)), limits_(limits) {
  for (size_t i = 0; i < kStreamKinds; ++i) {
    budgets_[i] = std::make_shared<SendBudget>(limits_(static_cast<StreamKind>(i)).all_bytes);
    counts_[i] = metrics->AddCounter("rips_streams_unread_total",
                                     "Streams ended because their peer did not read what it was "
                                     "sent.",
                                     {{"stream", kNames[i]}});
  }
}

OutboundLimits UnreadStreams::LimitsFor(StreamKind kind, const Peer& peer,
                                        const std::string& address) {
  const std::string identity = ToString(peer.identity);
  return {.bytes = limits_(kind).stream_bytes,
          .budget = budgets_[Index(kind)],
          .owner = identity,
          .exceeded = [this, kind, identity, address](const std::string& why) {
            OnExceeded(kind, identity, address, why);
          }};
}

void UnreadStreams::OnExceeded(StreamKind kind, const std::string& who, const std::string& address,
                               const std::string& why) {
  counts_[Index(kind)].Increment();
  const int64_t now_ns = clock_->Now().boottime_ns;
  {
    MutexLock lock(&mu_);
    std::erase_if(told_ns_, [&](const auto& each) { return now_ns - each.second >= kTellEveryNs; });
    if (told_ns_.size() >= kToldMax || !told_ns_.emplace(who, now_ns).second) return;
  }
  LogWarning("stream closed: the peer does not read",
             {{"stream", kNames[Index(kind)]}, {"peer", who}, {"address", address}, {"why", why}});
  alert_(absl::StrCat(
      who, " at ", address, " does not read the ", kNames[Index(kind)], " stream that it opened: ",
      why, "; the stream was ended (more of this identity is only counted for a minute)"));
}

}  // namespace rips::rpc
