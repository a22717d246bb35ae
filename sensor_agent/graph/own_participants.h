// Which participants are RIPS's own, of all that call themselves `/rips`: those the server names,
// which knows them from agents that have shown their certificates. Names on the bus prove nothing.
//
// | the server            | it is RIPS's                                                          |
// |-----------------------|-----------------------------------------------------------------------|
// | names it              | yes                                                                   |
// | named it, not any more| yes: a server that was started again does not know an agent before    |
// |                       | that has reached it, and one that was killed stays on the bus until   |
// |                       | its lease ends; the last kFormerMax of them                           |
// | never named it        | no                                                                    |
#ifndef RIPS_SENSOR_AGENT_GRAPH_OWN_PARTICIPANTS_H_
#define RIPS_SENSOR_AGENT_GRAPH_OWN_PARTICIPANTS_H_

#include <cstddef>
#include <deque>
#include <vector>

#include "absl/container/btree_set.h"
#include "services/ros2/guid.h"

namespace rips::sensor {

// Not thread-safe.
class OwnParticipants {
 public:
  // Kept of those that the server names no longer; beyond, the oldest is not RIPS's any more.
  static constexpr size_t kFormerMax = 64;

  // All that the server names now. True if known() has changed.
  bool Told(const std::vector<ros2::Guid>& participants);
  // Sorted.
  const std::vector<ros2::Guid>& known() const { return known_; }

 private:
  absl::btree_set<ros2::Guid> told_;
  std::deque<ros2::Guid> former_;  // oldest first
  std::vector<ros2::Guid> known_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_GRAPH_OWN_PARTICIPANTS_H_
