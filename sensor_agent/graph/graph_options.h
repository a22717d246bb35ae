// Options, inputs and counters of GraphBuilder.
#ifndef RIPS_SENSOR_AGENT_GRAPH_GRAPH_OPTIONS_H_
#define RIPS_SENSOR_AGENT_GRAPH_GRAPH_OPTIONS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::sensor {

struct GraphOptions {
  // This sensor's participant.
  ros2::Guid own;
  // This sensor uses DDS Security in a domain that admits nobody without it: whoever shows an
  // endpoint has authenticated.
  bool secured = false;
  // No node `/rips` in the graph.
  bool observer_hidden = false;
  // ROS topics to which `/rips` does not subscribe. Their messages are read all the same if the
  // plan says so; before the first SetPlan it says metadata of every topic but these.
  std::vector<std::string> unwatched = {"/rosout", "/parameter_events"};
  int64_t attribution_grace_ns = 500'000'000;
  // Settled once nothing was discovered for settle_ns, at the latest settle_max_ns after start.
  int64_t settle_ns = 2'000'000'000;
  int64_t settle_max_ns = 10'000'000'000;
  // A burst of discovery ends when nothing came for quiet_ns, or after burst_max_ns.
  int64_t quiet_ns = 20'000'000;
  int64_t burst_max_ns = 100'000'000;
  // How long a claim is kept whose participant has not been discovered.
  int64_t orphan_claim_ns = 10'000'000'000;
  // What exceeds these is left out, counted, and told with the next step. `topics` is the server's
  // to keep. Reply sides of services, which are never shown, have the same limits for themselves.
  ros2::GraphLimits limits;
  // Estimated size of one step; a larger one is sent in several, of which only the last is settled.
  size_t step_bytes = size_t{1} << 20;
};

// An endpoint as the middleware discovered it; DDS names.
struct EndpointFact {
  ros2::Guid guid;
  bool writer = false;  // else reader
  std::string topic;
  std::string type;
  ros2::Qos qos;
  // Why no reader of ours can match this writer; empty = one can.
  std::string unreadable;
};

struct GraphCounters {
  // Messages of ros_discovery_info that speak for another participant, and endpoints of others
  // listed in one.
  uint64_t foreign_claims = 0;
  // Participants, nodes and endpoints left out because of a limit, evicted ones included.
  uint64_t dropped = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_GRAPH_GRAPH_OPTIONS_H_
