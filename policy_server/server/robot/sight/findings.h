// The findings of a robot's sensors: each that begins is an alert, whatever the rules say, and so
// is the end of one that an alert names. Rules are told which stand. Pure.
//
//   alert          severity   limit (AlertLimiter)         beyond it, a summary
//   a finding      high       one for each kind of rules   how many, how many of these stand, and
//   begins                    and one for all others       the newest of them by name
//   it has ended   info       as many of its own           how many, and the last one
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDINGS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDINGS_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/container/btree_set.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/policy/engine/state/trace.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/evidence_gate.h"
#include "policy_server/server/robot/model/inbound.h"
#include "policy_server/server/robot/sensors/sensor_side.h"
#include "policy_server/server/robot/sight/finding_registry.h"
#include "policy_server/server/robot/sight/findings_known.h"
#include "policy_server/server/robot/sight/sight.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Findings {
 public:
  // `state`: of the rules, which see the graph in force, and which findings stand.
  // `gate`: is told when one begins.
  Findings(Context* context, Alerts* alerts, const SensorSide* sensors, const Sight* sight,
           engine::RobotState* state, EvidenceGate* gate)
      : context_(*context),
        alerts_(*alerts),
        sensors_(*sensors),
        state_(*state),
        gate_(*gate),
        known_(context, sensors, sight, state, &registry_) {}

  // True if rules are to judge it.
  bool OnFinding(const std::string& host, const std::string& incarnation,
                 const FindingSeen& finding);
  // A session of that sensor has begun; nothing of it is judged yet.
  void OnHello(const SensorHost& host);
  // Of that session, not of the backlog.
  void OnState(const SensorHost& host, const SensorStateSeen& state);
  // The inventory lists others.
  void OnHosts();
  // Those whose sensors are to tell again what stands; an alert if that has not helped before. Call
  // it from time to time.
  std::vector<std::string> ToAsk();
  // Call at least once a second.
  void Expire();
  // Tells the rules. Call it before they are run when anything of a sensor may have changed.
  void Update();
  // Raises the summaries that are due. Call it before Alerts::Summarize.
  void Summarize();

  // As of the last Update.
  const engine::StandingFindings& seen_by_rules() const { return state_.findings; }
  const FindingsKnown& known() const { return known_; }

 private:
  // A kind of alerts of which some were folded away.
  struct Folded {
    // Its limit; empty = none.
    std::string limit;
    // One of the kinds of rules; empty = all others.
    std::string kind;
    bool ends = false;

    friend auto operator<=>(const Folded&, const Folded&) = default;
  };

  // After one of that kind has begun or ended; then Recount.
  void SetOther(const std::string& kind);
  void Recount();
  void RaiseEnd(absl::string_view what, FindingSeen finding, bool named);
  std::string SummaryOf(const Folded& kind, const FoldedAlerts& folded,
                        FindingRegistry::Entry* newest, size_t standing) const;

  Context& context_;
  Alerts& alerts_;
  const SensorSide& sensors_;
  engine::RobotState& state_;
  EvidenceGate& gate_;
  FindingRegistry registry_;
  const FindingsKnown known_;
  // Kinds that stand, and those of them that rules cannot name.
  engine::StandingFindings kinds_;
  absl::btree_set<std::string> others_;
  absl::btree_set<Folded> folded_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDINGS_H_
