// Graphs that are judged after their time: what rules are run on beside the graph in force. Pure.
//
// A sensor that is stopped leaves the changes of its graph that no server has judged to its next
// process. Each is an event of the rules, against a graph that is never in force. Variables that
// rules keep about the graph are then of another one than that in force, so the rules are evaluated
// on the graph in force again after the late events.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CORE_LATE_GRAPH_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CORE_LATE_GRAPH_H_

#include <cstdint>
#include <optional>
#include <string>
#include <utility>

#include "policy_server/policy/engine/evaluator.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/evidence_gate.h"
#include "policy_server/server/robot/decide/decider.h"
#include "policy_server/server/robot/line/former_graph.h"
#include "policy_server/server/robot/sensors/sensor_host.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class LateGraph {
 public:
  LateGraph(Context* context, engine::RobotState* state, EvidenceGate* gate, Decider* decider)
      : context_(*context), state_(*state), gate_(*gate), decider_(*decider) {}

  // A step of a graph of `incarnation`, which is over and was of `host`. False: it goes on from
  // nothing that is known.
  bool Apply(const SensorHost& host, const std::string& incarnation, const GraphChange& change);
  // Discovery had settled in the graph that Apply has led to.
  bool settled() const { return former_.settled(); }
  // Runs the rules on it, as late. `event` has the time of the last step.
  void Judge(engine::Event event);
  // The event is held back; true once: it still is.
  void HoldBack() { held_back_ = true; }
  bool WasHeldBack() { return std::exchange(held_back_, false); }

  // Rules were run on another graph than the one in force, and keep something of it.
  void OnKept();
  // No difference between two graphs leads from what rules were run on last to the one in force.
  bool look_again() const { return kept_ns_.has_value(); }
  // Rules were run on the graph in force.
  void OnLook(const SensorHost& host) {
    if (!host.HasBacklog()) kept_ns_.reset();
  }
  // Runs the rules on the graph in force if they must look again, all that is late has been judged,
  // and the graph is of the process that goes on. A second after they were run on the other, since
  // more of that time may come: rules would tell the same again and again.
  void LookAgain(const SensorHost* host);

 private:
  Context& context_;
  engine::RobotState& state_;
  EvidenceGate& gate_;
  Decider& decider_;
  FormerGraph former_{FormerGraph::kOfControl};
  bool held_back_ = false;
  // Since when they must look again.
  std::optional<int64_t> kept_ns_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CORE_LATE_GRAPH_H_
