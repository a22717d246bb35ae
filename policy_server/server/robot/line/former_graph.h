// The graph of a former incarnation of a sensor, as it comes late: with messages
// (ObservationBatch.graph), or by steps of the control lane that no server had judged when that
// incarnation ended. It judges these and nothing else: it is never in force.
//
// Where the graph that judges such a message does not show its writer, the writer is added as the
// message names it: it was in the graph when it wrote, so "only these publish" must be false.
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
  // Below the revisions of its graphs; no other graph that is judged by may have one of them.
  static constexpr uint64_t kOfMessages = uint64_t{1} << 63;
  static constexpr uint64_t kOfControl = uint64_t{3} << 62;

  explicit FormerGraph(uint64_t revisions_above) : revision_(revisions_above) {}

  // What `incarnation` tells next. Steps that do not fit make the graph unknown until the next
  // snapshot; those that are repeated do nothing. Limits and kept topics are those of `like`.
  void Apply(const std::string& incarnation, absl::Span<const model::GraphChange> steps,
             const ros2::RosGraph& like);

  // For what `incarnation` took under version `number` or an earlier one; null if its graph is not
  // known. Holds until the next Apply.
  const Version* Of(const std::string& incarnation, uint64_t number);
  // The last that was told; null if it is not known. Holds as above.
  const Version* newest() { return Of(incarnation_, number_); }
  // Of it; 0 = it is not known.
  uint64_t number() const { return number_; }
  // Discovery had settled.
  bool settled() const { return settled_; }

  // Each graph is a copy: so many writers are added to one.
  static constexpr size_t kAddedMax = 16;
  // `base`, which does not show `writer`, with it and those added to the same base before. Null if
  // they are too many, or if it does not fit. Holds until the next call.
  const Version* With(const Version& base, const ros2::Endpoint& writer);

 private:
  std::string incarnation_;
  uint64_t number_ = 0;
  bool settled_ = false;
  ros2::RosGraph graph_;
  // A copy of it, made when it is asked for.
  Version version_ = {};
  // Of the graph to which writers were added.
  uint64_t base_revision_ = 0;
  Version with_added_ = {};
  size_t added_ = 0;
  // Given last.
  uint64_t revision_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_FORMER_GRAPH_H_
