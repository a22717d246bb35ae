// Whether a graph shows the robot, and all of it. A graph that shows no ROS node is no proof of
// calm: the sensor may watch the wrong domain or the wrong interface. Pure.
//
// | the settled graph of the primary sensor                           | problem                  |
// |-------------------------------------------------------------------|--------------------------|
// | shows no ROS node and no ROS endpoint but those of RIPS           | sees no ROS node; what   |
// |                                                                   | to do depends on `moved` |
// | lacks a part whose modes an actuator sets: no node of that name,  | does not see these parts |
// | and no service below that name (`/safety/change_mode`)            |                          |
// | hit a limit and leaves something out                              | does not hold all of it  |
// | else                                                              | none                     |
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_GRAPH_HEALTH_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_GRAPH_HEALTH_H_

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "services/base/clock.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::pipeline {

// What a graph is measured by.
struct GraphExpectation {
  // Host of the sensor whose graph it is, and the DDS domain that it watches.
  std::string sensor;
  uint32_t domain = 0;
  // Participants of RIPS on this robot, as far as they are known.
  std::vector<ros2::Guid> own_participants;
  // Full names of the parts whose modes the actuators set.
  std::vector<std::string> parts;
  // The sensor says that the addresses of DDS on its host have changed.
  bool moved = false;
};

struct GraphHealth {
  // Nobody but RIPS is on the bus.
  bool empty = false;
  // For people, printable; both empty = the graph shows the robot, and all of it.
  std::vector<std::string> problems;
  std::string truncated;
};

// O(endpoints): call it when the graph has changed.
GraphHealth ExamineGraph(const ros2::RosGraph& graph, const GraphExpectation& expected);

// The participant that fills a truncated graph, with counts, human-readable and printable: the one
// with the most nodes and endpoints, those that were left out included. Subscriptions of `/rips` do
// not count: it has one for every topic of others. Empty for an empty graph.
std::string LargestParticipant(const ros2::RosGraph& graph);

// "participant GUID (host H, pid P, node /a and 2 more)", printable; host and pid are its claims.
std::string DescribeParticipant(const ros2::RosGraph& graph, const ros2::Guid& participant);

// Tells once that something is not seen, and once that everything is seen again.
//
// A reason is told when it has stood for kGraceNs: a robot whose ROS stack is starting, or stopped,
// is no news by the second. That DDS begins again on other addresses (services/model/dds_problem.h)
// is told at once. One that comes and goes is told again after kForgetNs without it.
class BlindAlarm {
 public:
  static constexpr int64_t kGraceNs = 60 * kNanosPerSecond;
  static constexpr int64_t kForgetNs = 600 * kNanosPerSecond;
  // Reasons that are remembered; further ones are not told.
  static constexpr size_t kReasonsMax = 256;

  // What is not seen now; times never go back.
  void Set(const std::vector<std::string>& reasons, int64_t now_ns);
  // Reasons that are to be told now.
  std::vector<std::string> Due(int64_t now_ns);
  // True once when nothing stands any more of what was told.
  bool Over();

 private:
  struct Reason {
    int64_t since_ns = 0;
    bool told = false;
    // Gone since then; nullopt = it stands.
    std::optional<int64_t> gone_ns;
  };
  absl::btree_map<std::string, Reason> reasons_;
  // Something was told that is not over.
  bool told_ = false;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_GRAPH_HEALTH_H_
