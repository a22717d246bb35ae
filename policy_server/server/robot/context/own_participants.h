// The DDS participants that one agent says are its own. The newest stands while the agent is away;
// an earlier one is given up after a while: on the bus a process that was killed goes on until its
// lease ends, and is no unauthorised node for that. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_OWN_PARTICIPANTS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_OWN_PARTICIPANTS_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "services/base/clock.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::pipeline {

// Node that all processes of RIPS are in the graph.
inline constexpr char kRipsNode[] = "/rips";

// Not thread-safe; times are CLOCK_BOOTTIME.
class OwnParticipants {
 public:
  // How many of one agent, and how long one after the next.
  static constexpr size_t kMax = 8;
  static constexpr int64_t kKeptNs = 30 * kNanosPerSecond;

  // Not none.
  void Add(const ros2::Guid& participant, int64_t now_ns);
  // True if one was given up.
  bool Expire(int64_t now_ns);
  void AppendTo(std::vector<ros2::Guid>& all) const;

 private:
  struct Known {
    ros2::Guid guid;
    // 0 = the newest.
    int64_t until_ns = 0;
  };
  // The newest last.
  std::deque<Known> known_;
};

// The node, of those that are not RIPS's own, that a participant in `graph` has; none if it has
// none. An agent's key must not make one of RIPS's own of an intruder's participant.
std::optional<std::string> ForeignNodeOf(const ros2::RosGraph& graph,
                                         const ros2::Guid& participant);

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_OWN_PARTICIPANTS_H_
