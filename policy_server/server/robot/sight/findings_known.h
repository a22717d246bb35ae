// What is known of the findings of one robot's sensors, to operators and to rules: which stand, and
// why that may not be all. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDINGS_KNOWN_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDINGS_KNOWN_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/model/inbound.h"
#include "policy_server/server/robot/model/standing_findings.h"
#include "policy_server/server/robot/sensors/sensor_side.h"
#include "policy_server/server/robot/sight/finding_registry.h"
#include "policy_server/server/robot/sight/sight.h"

namespace rips::pipeline {

// As of context.moment. Not thread-safe. All that it is given outlives it.
class FindingsKnown {
 public:
  // `rules`: their state, which has the graph in force.
  FindingsKnown(const Context* context, const SensorSide* sensors, const Sight* sight,
                const engine::RobotState* rules, const FindingRegistry* registry)
      : context_(*context),
        sensors_(*sensors),
        sight_(*sight),
        rules_(*rules),
        registry_(*registry) {}

  // Oldest first.
  std::vector<FindingSeen> standing() const { return registry_.standing(); }
  size_t total() const { return registry_.entries().size(); }
  FindingsNow Now() const;
  // Of the finding with that kind, GUID, node and topic.
  FindingState StateOf(const FindingSeen& finding) const;
  // The sensors have told all.
  bool All() const;
  // Why they have not, or why some of it may no longer stand; empty = they have. At most
  // kNotKnownMax.
  std::vector<std::string> NotKnown() const;
  // What stands that sends under the name of one of these participants, or answers in place of
  // one, so that what is read back from it may be forged; printable, empty = nothing.
  std::string ForgeryOf(const std::vector<ros2::Guid>& participants) const;
  // Why what the sensor says may be old; empty = it is not.
  std::string NotCurrent(const SensorHost& host) const;

 private:
  // Why the sensor may have more to tell, or less; empty = it has told all.
  std::string NotToldAll(const SensorHost& host) const;
  int64_t UnixOf(int64_t boottime_ns) const;

  const Context& context_;
  const SensorSide& sensors_;
  const Sight& sight_;
  const engine::RobotState& rules_;
  const FindingRegistry& registry_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDINGS_KNOWN_H_
