// `ripsctl rules replay`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_REPLAY_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_REPLAY_H_

#include <memory>

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

// Runs rules on a recording. JSON is that of policy_server/policy/replay/result_json.h; with
// `--against` it has `"against"`, the difference to what the other rules do. Exits with kDone when
// it ran, kRefused for rules that do not compile (with the output of `rules check`), kUsage for
// what cannot be read and for levels that the rules do not have; then nothing is printed but the
// error.
std::unique_ptr<Command> ReplayRules();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_REPLAY_H_
