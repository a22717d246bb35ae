#include "sensor_agent/outbox/graph_base.h"

#include "sensor_agent/outbox/outbox.h"

namespace rips::sensor {

void GraphBase::Apply(const GraphChange& change) {
  if (change.from_version == 0) {
    graph_ = ros2::RosGraph(ros2::kWideGraphLimits);
  } else if (version_ == 0 || change.from_version != version_) {
    return Forget();
  }
  if (!graph_.Apply(change.delta).ok() || graph_.dropped() > 0) return Forget();
  version_ = change.to_version;
  settled_ = change.settled;
}

std::optional<GraphChange> GraphBase::Snapshot() const {
  if (version_ == 0) return std::nullopt;
  GraphChange snapshot{.from_version = 0,
                       .to_version = version_,
                       .settled = settled_,
                       .delta = ros2::RosGraph::Diff(ros2::RosGraph(), graph_)};
  if (CostOf(snapshot.delta) > kSnapshotBytesMax) return std::nullopt;
  return snapshot;
}

std::optional<GraphChange> GraphBase::SnapshotAfter(const GraphChange& next) const {
  GraphBase after = *this;
  after.Apply(next);
  return after.Snapshot();
}

}  // namespace rips::sensor
