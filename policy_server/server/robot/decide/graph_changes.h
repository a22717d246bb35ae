// How one graph differs from a former one, in words for operators. What no rule and no operator can
// judge, such as a participant without node and topic, is no difference. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_GRAPH_CHANGES_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_GRAPH_CHANGES_H_

#include <cstddef>
#include <string>
#include <vector>

#include "services/ros2/graph_limits.h"
#include "services/ros2/ros_graph.h"

namespace rips::pipeline {

// The last of them says how many more there are.
inline constexpr size_t kChangesMax = 16;

// Nodes that came or left, by name, then topics whose publishers, subscribers or types are others:
// `node /visitor came`, `topic /scan: /visitor subscribes`. Printable.
std::vector<std::string> GraphChanges(const ros2::RosGraph& before, const ros2::RosGraph& now);

// Which of `topics` others publish, or publish another type; one of them, or empty = none.
std::string PublisherChange(const ros2::RosGraph& before, const ros2::RosGraph& now,
                            const ros2::TopicNames& topics);

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_GRAPH_CHANGES_H_
