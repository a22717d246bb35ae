// What the firewall of the level that is held has dropped: how much, and how long nothing was.
// rips-fw counts since its table was made; this begins to count when a level is entered. Pure; used
// by one thread, times are CLOCK_BOOTTIME nanoseconds.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_DROP_WATCH_H_
#define RIPS_MODE_ACTUATOR_DECIDE_DROP_WATCH_H_

#include <cstdint>
#include <optional>

#include "services/model/receipt.h"

namespace rips::actuator {

class DropWatch {
 public:
  // A level is entered: nothing was seen of it.
  void Reset() { first_ns_.reset(); }
  // The table had dropped `packets` at `now_ns`. Fewer than before: the table was made anew.
  void Saw(uint64_t packets, int64_t now_ns);

  // nullopt: nothing was seen; the level has no firewall.
  std::optional<model::FirewallDrops> Report(int64_t now_ns) const;

 private:
  std::optional<int64_t> first_ns_;  // since when it is counted
  uint64_t last_ = 0;                // as of the newest Saw
  uint64_t packets_ = 0;             // since first_ns_
  int64_t newest_ns_ = 0;            // when packets_ grew last; first_ns_ if it never did
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_DROP_WATCH_H_
