// What the firewall of the level that is held has dropped: how much, and how long nothing was.
// rips-fw's counter runs since its table was made; its sources begin anew with each level, and this
// with them. Pure; used by one thread, times are CLOCK_BOOTTIME nanoseconds.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_DROP_WATCH_H_
#define RIPS_MODE_ACTUATOR_DECIDE_DROP_WATCH_H_

#include <cstdint>
#include <optional>
#include <vector>

#include "services/model/receipt.h"

namespace rips::actuator {

// As rips-fw counts.
struct DropCount {
  // On their way in, since the table was made.
  uint64_t packets = 0;
  // From whom, the newest first, at most kDropSourcesMax; and how many others.
  std::vector<model::DropSource> sources;
  uint32_t more_sources = 0;

  friend bool operator==(const DropCount&, const DropCount&) = default;
};

class DropWatch {
 public:
  // A level is entered: nothing was seen of it.
  void Enter(int64_t now_ns);
  // What the table had dropped at `now_ns`. Less than before: the table was made anew.
  void Saw(const DropCount& count, int64_t now_ns);

  // nullopt: nothing was seen; the level has no firewall.
  std::optional<model::FirewallDrops> Report(int64_t now_ns) const;

 private:
  int64_t entered_ns_ = 0;         // since when it is counted
  std::optional<DropCount> last_;  // as of the newest Saw
  int64_t last_ns_ = 0;            // its time
  uint64_t packets_ = 0;           // since entered_ns_
  int64_t newest_ns_ = 0;          // when packets_ grew last, or the first Saw
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_DROP_WATCH_H_
