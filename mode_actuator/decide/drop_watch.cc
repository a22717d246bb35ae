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

void DropWatch::Enter(int64_t now_ns) {
  *this = DropWatch();
  entered_ns_ = now_ns;
}

void DropWatch::Saw(const DropCount& count, int64_t now_ns) {
  if (!last_.has_value()) {
    // How much of the counter is this level's, only its sources tell.
    for (const model::DropSource& source : count.sources) packets_ += source.packets;
    packets_ = std::min(packets_, count.packets);
    newest_ns_ = now_ns;
  } else if (count.packets != last_->packets) {
    packets_ += count.packets > last_->packets ? count.packets - last_->packets : count.packets;
    newest_ns_ = now_ns;
  }
  last_ = count;
  last_ns_ = now_ns;
}

std::optional<model::FirewallDrops> DropWatch::Report(int64_t now_ns) const {
  if (!last_.has_value()) return std::nullopt;
  model::FirewallDrops drops = {.packets = packets_,
                                .counted_s = WholeSeconds(now_ns - entered_ns_),
                                .quiet_s = WholeSeconds(now_ns - newest_ns_),
                                .sources = last_->sources,
                                .more_sources = last_->more_sources};
  for (model::DropSource& source : drops.sources) {
    source.quiet_s = static_cast<uint32_t>(
        std::min<uint64_t>(uint64_t{source.quiet_s} + WholeSeconds(now_ns - last_ns_),
                           std::numeric_limits<uint32_t>::max()));
  }
  return drops;
}

}  // namespace rips::actuator
