#include "mode_actuator/decide/drop_watch.h"

#include <algorithm>
#include <limits>

#include "services/base/clock.h"

namespace rips::actuator {
namespace {

uint32_t WholeSeconds(int64_t ns) {
  return static_cast<uint32_t>(
      std::clamp<int64_t>(ns / kNanosPerSecond, 0, std::numeric_limits<uint32_t>::max()));
}

}  // namespace

void DropWatch::Saw(uint64_t packets, int64_t now_ns) {
  if (!first_ns_.has_value()) {
    first_ns_ = now_ns;
    newest_ns_ = now_ns;
    packets_ = 0;
  } else if (packets != last_) {
    packets_ += packets > last_ ? packets - last_ : packets;
    newest_ns_ = now_ns;
  }
  last_ = packets;
}

std::optional<model::FirewallDrops> DropWatch::Report(int64_t now_ns) const {
  if (!first_ns_.has_value()) return std::nullopt;
  return model::FirewallDrops{.packets = packets_,
                              .counted_s = WholeSeconds(now_ns - *first_ns_),
                              .quiet_s = WholeSeconds(now_ns - newest_ns_)};
}

}  // namespace rips::actuator
