// What keeps the evidence of one robot from being complete: its sensors, what is not seen, its
// actuators and the store. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_EVIDENCE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_EVIDENCE_H_

#include <string>
#include <vector>

#include "policy_server/server/robot/actuators/actuator_side.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/evidence_gate.h"
#include "policy_server/server/robot/sensors/sensor_side.h"
#include "policy_server/server/robot/sight/sight.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Evidence {
 public:
  Evidence(const Context* context, EvidenceGate* gate, const SensorSide* sensors,
           const Sight* sight, const ActuatorSide* actuators)
      : context_(*context),
        gate_(*gate),
        sensors_(*sensors),
        sight_(*sight),
        actuators_(*actuators) {}

  // As of context.moment; empty = complete.
  std::vector<std::string> Problems() const;
  // Tells the gate. Call it when any of these may have changed, before rules are run.
  void Update() { gate_.Update(Problems(), actuators_.verified(), context_.now()); }
  // What sensors have sent is judged, and says something: a floor may be lifted.
  bool complete() const {
    return sight_.blind().empty() && !context_.moment.backlog && sensors_.complete() &&
           actuators_.stage() != Stage::kContradicted;
  }

 private:
  const Context& context_;
  EvidenceGate& gate_;
  const SensorSide& sensors_;
  const Sight& sight_;
  const ActuatorSide& actuators_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_EVIDENCE_H_
