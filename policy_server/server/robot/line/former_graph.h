// The graph that messages of a former incarnation bring with them (ObservationBatch.graph): what
// the sensor saw when it took them. Theirs and no others': it is never in force.
//
// Where the graph that judges such a message does not show its writer, the writer is added as the
// message names it: whoever wrote was there, so "only these publish" must not hold without it.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_FORMER_GRAPH_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_FORMER_GRAPH_H_

#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/types/span.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "services/model/observation.h"
#include "services/ros2/ros_graph.h"

namespace rips::pipeline {

// Not thread-safe. Holds one graph: streams of former incarnations come one after the other.
class FormerGraph {
 public:
  using Version = engine::CurrentGraph::Version;

  // A batch of `incarnation` that brings `steps` is judged next. Steps that do not fit make the
  // graph unknown until the next snapshot; those that are repeated do nothing. Limits and kept
  // topics are those of `like`.
  void Apply(const std::string& incarnation, absl::Span<const model::GraphChange> steps,
             const ros2::RosGraph& like);

  // For a message of `incarnation` that names version `number`; null if its graph is not known.
  const Version* Of(const std::string& incarnation, uint64_t number) const;

  // Each graph is a copy: so many writers are added to one.
  static constexpr size_t kAddedMax = 16;
  // `base`, which does not show `writer`, with it and those added to the same base before. Null if
  // they are too many, or if it does not fit. Holds until the next call.
  const Version* With(const Version& base, const ros2::Endpoint& writer);

 private:
  std::string incarnation_;
  // 0 = not known.
  uint64_t number_ = 0;
  Version version_ = {};
  // Of the graph to which writers were added.
  uint64_t base_revision_ = 0;
  Version with_added_ = {};
  size_t added_ = 0;
  // Given last, to a graph that was made here; none that a graph in force ever has.
  uint64_t revision_ = uint64_t{1} << 63;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_FORMER_GRAPH_H_
