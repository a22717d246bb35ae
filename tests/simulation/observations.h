// What a simulated sensor sees: the robot's graph and messages, and their form on the server.
#ifndef RIPS_TESTS_SIMULATION_OBSERVATIONS_H_
#define RIPS_TESTS_SIMULATION_OBSERVATIONS_H_

#include <cstdint>
#include <memory>

#include "policy_server/server/robot/model/inbound.h"
#include "sensor_agent/outbox/observation.h"
#include "services/ros2/ros_graph.h"

namespace rips::simulation {

// The whole graph: camera and navigator, and the intruder if it is there.
ros2::GraphDelta GraphNow(bool intruder);
// The writer of /cmd_vel: the intruder's, or the navigator's.
std::shared_ptr<const sensor::MessageSource> SourceOf(bool intruder);

pipeline::Observation ToServerObservation(const sensor::ControlObservation& seen);
pipeline::Observation ToServerObservation(const sensor::MessageSeen& seen);

// The name by which the checker follows it; 0 = it does not.
uint64_t ObservationId(const pipeline::Observation& seen);

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_OBSERVATIONS_H_
