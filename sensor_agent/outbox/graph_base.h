// The graph as far as the server has acknowledged it. With it the steps after that can be sent to a
// server that holds no graph, none of them left out: a node that came and went while the server was
// away is judged, too.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_GRAPH_BASE_H_
#define RIPS_SENSOR_AGENT_OUTBOX_GRAPH_BASE_H_

#include <cstddef>
#include <cstdint>
#include <optional>

#include "sensor_agent/outbox/observation.h"
#include "services/ros2/ros_graph.h"

namespace rips::sensor {

// Not thread-safe.
class GraphBase {
 public:
  // Of a snapshot made here, in the estimate of CostOf. A larger graph is not known.
  static constexpr size_t kSnapshotBytesMax = size_t{1} << 20;

  // `change` was acknowledged.
  void Apply(const GraphChange& change);
  // Steps are left out: what comes next may not fit.
  void Forget() { version_ = 0; }

  // What holds instead of the graph at hand: a snapshot of the base, or, with `next`, of the graph
  // after that step. nullopt if the base is not known, `next` does not fit it, or it is too large.
  std::optional<GraphChange> Snapshot() const;
  std::optional<GraphChange> SnapshotAfter(const GraphChange& next) const;

  uint64_t version() const { return version_; }

 private:
  ros2::RosGraph graph_;
  // 0 = not known.
  uint64_t version_ = 0;
  bool settled_ = false;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_GRAPH_BASE_H_
