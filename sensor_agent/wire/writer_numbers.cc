#include "sensor_agent/wire/writer_numbers.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "sensor_agent/wire/rtps_parser.h"
#include "services/base/clock.h"

namespace rips::wire {

namespace {

std::string WentBack(absl::string_view what, uint64_t number, uint64_t highest) {
  return absl::StrCat(what, " ", number, " after ", highest);
}

}  // namespace

std::string WriterNumbers::Take(const Traffic& traffic, int64_t now_ns) {
  const uint64_t highest =
      std::max({traffic.data_last, traffic.heartbeat_last, traffic.dropped_last});
  if (highest == 0) return "";
  const uint64_t data = HasKeys(traffic.writer) ? 0 : traffic.data_least;
  const uint64_t heartbeat = traffic.heartbeat_least;
  std::string why;
  if (highest_ == 0) {
    const bool apart =
        (data > 0 && data + kJump < highest) || (heartbeat > 0 && heartbeat + kJump < highest);
    if (apart) {
      why = absl::StrCat("number ", data > 0 ? data : heartbeat, " and number ", highest,
                         " at the same time");
    }
  } else if (data > 0 && data + kJump < highest_) {
    why = WentBack("number", data, highest_);
  } else if (heartbeat > 0 && heartbeat + kHeartbeatBack < highest_) {
    why = WentBack("last number by HEARTBEAT", heartbeat, highest_);
  } else if (highest > highest_) {
    const auto elapsed_ms = static_cast<uint64_t>((now_ns - highest_ns_) / kNanosPerMilli);
    const uint64_t possible = kJump + kRateMax / 1'000 * std::min<uint64_t>(elapsed_ms, 1ull << 40);
    if (highest - highest_ > possible) {
      why = absl::StrCat("number ", highest, " right after ", highest_);
    }
  }
  if (!why.empty()) {
    highest_ = 0;
    return why;
  }
  if (highest >= highest_) {
    highest_ = highest;
    highest_ns_ = now_ns;
  }
  return why;
}

}  // namespace rips::wire
