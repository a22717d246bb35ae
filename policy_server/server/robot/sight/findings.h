// The findings of a robot's sensors: each that begins is an alert, whatever the rules say. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDINGS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDINGS_H_

#include <string>
#include <vector>

#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/model/inbound.h"
#include "policy_server/server/robot/sight/finding_registry.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Findings {
 public:
  Findings(Context* context, Alerts* alerts) : context_(*context), alerts_(*alerts) {}

  // True if rules are to judge it.
  bool OnFinding(const std::string& host, const std::string& incarnation,
                 const FindingSeen& finding);
  // The sensor speaks as this incarnation from now on.
  void OnIncarnation(const std::string& host, const std::string& incarnation);
  // Call at least once a second.
  void Expire();
  // Oldest first.
  std::vector<FindingSeen> standing() const { return registry_.standing(); }

 private:
  Context& context_;
  Alerts& alerts_;
  FindingRegistry registry_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDINGS_H_
