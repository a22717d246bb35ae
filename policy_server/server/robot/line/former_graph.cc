#include "policy_server/server/robot/line/former_graph.h"

#include <algorithm>
#include <memory>
#include <utility>

namespace rips::pipeline {

void FormerGraph::Apply(const std::string& incarnation, absl::Span<const model::GraphChange> steps,
                        const ros2::RosGraph& like) {
  if (steps.empty()) return;
  if (incarnation != incarnation_) number_ = 0;
  incarnation_ = incarnation;
  const auto whole =
      std::find_if(steps.rbegin(), steps.rend(), [](const auto& step) { return step.whole(); });
  if (whole != steps.rend()) steps.remove_prefix(static_cast<size_t>(steps.rend() - whole) - 1);
  for (const model::GraphChange& step : steps) {
    if (!step.whole() && step.to_version <= number_) continue;
    const bool fits = step.whole() || (number_ != 0 && step.from_version == number_);
    if (step.whole()) {
      graph_ = like;
      graph_.Clear();
      settled_ = false;
    }
    number_ = fits && graph_.Apply(step.delta).ok() ? step.to_version : 0;
    settled_ |= step.settled;
    version_.graph = nullptr;
  }
}

const FormerGraph::Version* FormerGraph::Of(const std::string& incarnation, uint64_t number) {
  if (number_ == 0 || number > number_ || incarnation != incarnation_) return nullptr;
  if (version_.graph == nullptr) {
    version_ = {std::make_shared<const ros2::RosGraph>(graph_), ++revision_};
  }
  return &version_;
}

const FormerGraph::Version* FormerGraph::With(const Version& base, const ros2::Endpoint& writer) {
  if (base_revision_ != base.revision || with_added_.graph == nullptr) {
    base_revision_ = base.revision;
    with_added_ = base;
    added_ = 0;
  }
  if (with_added_.graph->FindEndpoint(writer.guid) != nullptr) return &with_added_;
  if (added_ == kAddedMax) return nullptr;
  ++added_;
  const ros2::Guid participant = writer.guid.Participant();
  ros2::GraphDelta delta{.upsert_endpoints = {writer}};
  if (!with_added_.graph->participants().contains(participant)) {
    delta.upsert_participants.push_back({.guid = participant});
  }
  if (!writer.node.empty()) delta.upsert_nodes.push_back({writer.node, participant});
  ros2::RosGraph graph = *with_added_.graph;
  if (!graph.Apply(delta).ok() || graph.FindEndpoint(writer.guid) == nullptr) return nullptr;
  with_added_ = {std::make_shared<const ros2::RosGraph>(std::move(graph)), ++revision_};
  return &with_added_;
}

}  // namespace rips::pipeline
