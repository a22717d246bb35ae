// What the firewalls of a robot's level hold and drop, as `level` verbs and `explain` say it.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_FIREWALLS_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_FIREWALLS_H_

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/ripsctl/cli/env.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

struct FirewallOfHost {
  std::string host;
  // Steps that were carried out, `firewall isolate_host 10.0.0.66`.
  std::vector<std::string> steps;
  // Of the level that has them.
  v1::DecisionId decision_id;
  // That level is in force. Else the firewall is no longer renewed: it ends with its time.
  bool renewed = true;
  // Unset: its actuator has not said yet, is not connected, or is of an older version.
  std::optional<v1::HostFirewall> drops;
};

// Hosts whose newest firewall step holds something, of the level that `seen` names or of one before
// that no later step released; newest receipt first.
absl::StatusOr<std::vector<FirewallOfHost>> ReadFirewalls(Env& env, const std::string& robot,
                                                          const v1::GetLevelResponse& seen);

// One line for each step and what each host drops, and what that means for a lowering. Nothing if
// nothing is held; one line if that cannot be read.
void PrintFirewalls(const absl::StatusOr<std::vector<FirewallOfHost>>& firewalls, TextStream out);

// After a change of level: that nothing is held any more, or else what is. Nothing if nothing was
// held before, or if the robot's level cannot be read.
void PrintReleased(Env& env, const std::string& robot,
                   const absl::StatusOr<std::vector<FirewallOfHost>>& before);

// `says that it dropped 1240 packets in 300 s, none in the last 42 s`
std::string DropsText(const v1::HostFirewall& drops);
// From whom, a line each: `10.0.0.66: 1200 packets, none in the last 42 s`. Safe to print. `claims`
// has by address which node gave it as its own.
std::vector<std::string> SourceLines(const v1::HostFirewall& drops,
                                     const std::map<std::string, std::string>& claims = {});

// An array; null if that cannot be read.
Json FirewallsJson(const absl::StatusOr<std::vector<FirewallOfHost>>& firewalls);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_FIREWALLS_H_
