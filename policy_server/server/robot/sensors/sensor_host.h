// What a robot's core remembers of one sensor host.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SENSOR_HOST_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SENSOR_HOST_H_

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "policy_server/server/robot/context/input.h"
#include "policy_server/server/robot/model/coverage.h"
#include "policy_server/server/robot/model/inbound.h"
#include "policy_server/server/robot/sensors/sensor_health.h"
#include "policy_server/server/robot/sensors/sequence_track.h"
#include "services/ros2/ros_graph.h"

namespace rips::pipeline {

struct SensorSession {
  SessionId id = 0;
  std::string incarnation;
  // Server time minus the sensor's boottime, fixed at Hello.
  int64_t boottime_offset_ns = 0;
  int64_t unix_offset_ns = 0;
  int64_t heard_ns = 0;
  int64_t peer_boottime_ns = 0;
  uint32_t domain = 0;
  // Announced in Hello: evidence is incomplete until judged up to here.
  std::vector<SpooledRange> spooled;
  uint64_t judged_bytes = 0;
  uint64_t granted_bytes = 0;
  uint64_t judged_payload_bytes = 0;
  uint64_t granted_payload_bytes = 0;
  // Ids; what it uses is what it says.
  std::string interest_wanted;
  std::string interest_in_use;
  // Why it does not use the one wanted; printable.
  std::string interest_problem;
  ClockSkew skew;
  BoottimeOffset least_offset;
};

// A sensor host of the inventory, with or without a session.
struct SensorHost {
  std::string name;
  std::optional<SensorSession> session;
  SequenceTrack sequences;
  // Of the incarnation whose graph is held.
  std::string graph_incarnation;
  uint64_t graph_version = 0;
  // Collects an unsettled snapshot; becomes the robot's graph when settled.
  ros2::RosGraph graph;
  bool settled = false;
  bool lost = false;
  int64_t gone_since_ns = 0;
  // Up to where observations are judged and their effects durable.
  SequenceTrack durable;
  RestartCount restarts;
  RecentLosses losses;
  SensorStateSeen state;
  // When it said what `state` says of inputs, by its own clock.
  int64_t state_boottime_ns = 0;
  // Gaps were put down to a restored store; once for each start of the server.
  bool excused = false;

  // No graph is held; the next one has these limits and keeps these topics first.
  void BeginGraph(const ros2::GraphLimits& limits,
                  std::shared_ptr<const ros2::TopicNames> kept_topics);
  // Observations that were announced in its hello are not judged yet.
  bool HasBacklog() const;
  // HasBacklog is asked often, of a stream that lives for months: not of what is judged.
  void ForgetJudged();
  // The graph as the sensor of `incarnation` tells it. InvalidArgument: it makes no sense.
  absl::Status ApplySnapshot(const std::string& incarnation, const GraphChange& snapshot);
  absl::Status ApplyDelta(const std::string& incarnation, const GraphChange& delta);

 private:
  bool IsJudged(const SpooledRange& range) const;
};
using SensorHosts = absl::btree_map<std::string, SensorHost>;

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SENSOR_HOST_H_
