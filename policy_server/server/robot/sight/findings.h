// The findings of a robot's sensors: each that begins is an alert, whatever the rules say, and so
// is the end of one that an alert names. Pure.
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
#include "policy_server/server/robot/model/inbound.h"
#include "policy_server/server/robot/model/standing_findings.h"
#include "policy_server/server/robot/sensors/sensor_side.h"
#include "policy_server/server/robot/sight/finding_registry.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Findings {
 public:
  // `graph`: the one in force.
  Findings(Context* context, Alerts* alerts, const SensorSide* sensors,
           const engine::CurrentGraph* graph)
      : context_(*context), alerts_(*alerts), sensors_(*sensors), graph_(*graph) {}

  // True if rules are to judge it.
  bool OnFinding(const std::string& host, const std::string& incarnation,
                 const FindingSeen& finding);
  // A session of that sensor has begun; nothing of it is judged yet.
  void OnHello(const SensorHost& host);
  // Call at least once a second.
  void Expire();
  // Raises the summaries that are due. Call it before Alerts::Summarize.
  void Summarize();

  // Oldest first.
  std::vector<FindingSeen> standing() const { return registry_.standing(); }
  size_t total() const { return registry_.entries().size(); }
  FindingsNow Now() const;
  // Of the finding with that kind, GUID, node and topic.
  FindingState StateOf(const FindingSeen& finding) const;
  // Why more may stand than is known, or some of it no longer; empty = the sensors have told all.
  std::vector<std::string> NotKnown() const;

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

  // Why what the sensor says may be old; empty = it is not.
  std::string NotCurrent(const SensorHost& host) const;
  engine::SharedTrace TraceOf(const FindingSeen& finding) const;
  int64_t UnixOf(int64_t boottime_ns) const;
  void Log(absl::string_view what, const FindingSeen& finding);
  void RaiseEnd(absl::string_view what, FindingSeen finding, bool named);
  std::string SummaryOf(const Folded& kind, const FoldedAlerts& folded,
                        FindingRegistry::Entry* newest, size_t standing) const;

  Context& context_;
  Alerts& alerts_;
  const SensorSide& sensors_;
  const engine::CurrentGraph& graph_;
  FindingRegistry registry_;
  absl::btree_set<Folded> folded_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDINGS_H_
