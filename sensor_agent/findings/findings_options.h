// How long a finding waits, and how many there may be.
#ifndef RIPS_SENSOR_AGENT_FINDINGS_FINDINGS_OPTIONS_H_
#define RIPS_SENSOR_AGENT_FINDINGS_FINDINGS_OPTIONS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "services/ros2/guid.h"

namespace rips::sensor {

struct FindingsOptions {
  // This sensor's participant.
  ros2::Guid own;
  // It uses DDS Security, and the domain's governance admits nobody without it.
  bool secured = false;
  // ROS topics that programs without a node may read.
  std::vector<std::string> raw_readers;
  int64_t foreign_grace_ns = 5'000'000'000;
  // Above the longest usual lease, 10 s with Cyclone DDS.
  int64_t rival_grace_ns = 15'000'000'000;
  // Above the longest usual lease of any middleware, 20 s with Fast DDS.
  int64_t rival_server_grace_ns = 25'000'000'000;
  int64_t slow_node_ns = 5'000'000'000;
  // Above that, too: the middleware believes no farewell of a participant that has not
  // authenticated, and who came and left within the handshake is nobody's finding.
  int64_t handshake_ns = 15'000'000'000;
  // A refused claim whose participant the graph does not show is forgotten then.
  int64_t orphan_claim_ns = 30'000'000'000;
  // Findings of one kind that are held, told or not. Further ones are counted in dropped().
  size_t findings_max = 256;
  // Of one kind in a minute, those that stand first. Then the rest; of what has gone, the number.
  size_t told_per_minute = 30;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_FINDINGS_FINDINGS_OPTIONS_H_
