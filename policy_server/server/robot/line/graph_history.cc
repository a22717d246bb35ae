#include "policy_server/server/robot/line/graph_history.h"

#include <utility>

namespace rips::pipeline {
namespace {

// Null if the graph does not show it, or only as pending.
const ros2::Endpoint* Shown(const ros2::RosGraph& graph, const ros2::Guid& writer) {
  const ros2::Endpoint* endpoint = graph.FindEndpoint(writer);
  return endpoint != nullptr && !endpoint->pending ? endpoint : nullptr;
}

}  // namespace

void GraphHistory::DropOldest() {
  endpoints_ -= held_.front().graph.graph->endpoints().size();
  held_.pop_front();
}

void GraphHistory::Add(const std::string& incarnation, uint64_t number, Version graph,
                       int64_t now_ns) {
  if (!held_.empty()) {
    held_.back().replaced_ns = now_ns;
    endpoints_ += held_.back().graph.graph->endpoints().size();
  }
  held_.push_back({.incarnation = incarnation, .number = number, .graph = std::move(graph)});
  given_up_.clear();
  while (held_.size() > 1 && (held_.size() > kVersionsMax + 1 || endpoints_ > kEndpointsMax)) {
    DropOldest();
  }
}

void GraphHistory::Expire(int64_t now_ns, bool backlog) {
  if (backlog) return;
  while (held_.size() > 1 && now_ns - held_.front().replaced_ns > kKeptNs) DropOldest();
}

GraphHistory::Choice GraphHistory::Choose(const std::string& incarnation, bool live,
                                          uint64_t number, const ros2::Guid& writer,
                                          const Version& newest, const Version* brought) const {
  const auto against = [&](const Version& version) {
    return Choice{.version = &version, .writer = Shown(*version.graph, writer)};
  };
  if (number == 0) return against(newest);
  if (!held_.empty() && held_.back().number == number && held_.back().incarnation == incarnation) {
    // The usual case.
    const Choice usual = against(held_.back().graph);
    if (usual.writer != nullptr || writer.none()) return usual;
  }
  const Held* oldest = nullptr;
  const Held* last = nullptr;
  for (const Held& held : held_) {
    if (held.incarnation != incarnation) continue;
    if (oldest == nullptr) oldest = &held;
    last = &held;
    if (held.number < number) continue;
    const Choice choice = against(held.graph);
    if (choice.writer != nullptr || writer.none()) return choice;
  }
  if (last == nullptr) {
    if (live) return {.wait = true, .version = &newest};
    if (brought != nullptr) return against(*brought);
    Choice choice = against(newest);
    choice.outlived = choice.writer == nullptr && !writer.none();
    return choice;
  }
  if (number < oldest->number) return against(oldest->graph);
  if (!live) return against(last->graph);
  if (last->number >= number && newest.graph->truncated()) return against(newest);
  if (given_up_.contains(writer)) return {.version = &newest, .unattributed = true};
  return {.wait = true, .version = &newest};
}

void GraphHistory::GiveUp(const ros2::Guid& writer) {
  if (given_up_.size() < kGivenUpMax) given_up_.insert(writer);
}

}  // namespace rips::pipeline
