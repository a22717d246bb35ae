#include "policy_server/server/robot/core/late_graph.h"

#include <string>
#include <utility>

namespace rips::pipeline {

bool LateGraph::Apply(const SensorHost& host, const std::string& incarnation,
                      const GraphChange& change) {
  former_.Apply(incarnation, {&change, 1}, host.graph);
  return former_.number() != 0;
}

void LateGraph::Judge(engine::Event event) {
  const FormerGraph::Version* former = former_.newest();
  if (former == nullptr) return;
  gate_.Disturb("changes of the graph were judged after the sensor had been started anew",
                context_.now());
  event.what = engine::GraphEvent{};
  event.lateness = levels::Lateness::kLate;
  const engine::CurrentGraph::Version in_force = state_.graph.version();
  state_.graph.Show(*former);
  decider_.Run(event,
               {.batch = nullptr,
                .remark = " (it came late: the sensor was stopped before a server had judged it)"});
  state_.graph.Show(in_force);
  OnKept();
}

void LateGraph::OnKept() {
  if (!kept_ns_) kept_ns_ = context_.now_ns();
}

void LateGraph::LookAgain(const SensorHost* host) {
  if (!kept_ns_ || host == nullptr || !host->session || host->HasBacklog()) return;
  if (!host->settled || host->graph_incarnation != host->session->incarnation) return;
  if (context_.now_ns() - *kept_ns_ < kNanosPerSecond) return;
  kept_ns_.reset();
  decider_.Run({.what = engine::GraphEvent{}, .time_unix_ns = context_.now().unix_ns});
}

}  // namespace rips::pipeline
