// `ripsctl rules replay`.
#ifndef RIPS_SERVICES_RIPSCTL_RULES_REPLAY_H_
#define RIPS_SERVICES_RIPSCTL_RULES_REPLAY_H_

#include <memory>

#include "services/ripsctl/command.h"

namespace rips::ripsctl {

// Runs rules on a recording. JSON is that of policy_server/replay/result_json.h; with `--against`
// it has `"against"`, the difference to what the other rules do. Exits with kDone when it ran,
// kRefused for rules that do not compile (with the output of `rules check`), kUsage for what cannot
// be read and for levels that the rules do not have; then nothing is printed but the error.
std::unique_ptr<Command> ReplayRules();

}  // namespace rips::ripsctl

#endif  // RIPS_SERVICES_RIPSCTL_RULES_REPLAY_H_
