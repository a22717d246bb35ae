// `ros_discovery_info` messages that no honest process sends, one of each kind.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_BAD_DISCOVERY_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_BAD_DISCOVERY_H_

#include <string>
#include <vector>

#include "services/ros2/guid.h"

namespace rips::robot_sim {

struct BadDiscoveryMessage {
  std::string name;
  std::string payload;
};

// `participant` is the sender. All but "foreign gid" are malformed; that one decodes, and speaks
// for a participant other than the sender.
std::vector<BadDiscoveryMessage> BadDiscoveryMessages(const ros2::Guid& participant);

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_BAD_DISCOVERY_H_
