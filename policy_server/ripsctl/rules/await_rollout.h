// Follows a roll-out until it is over: for `--wait`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_AWAIT_ROLLOUT_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_AWAIT_ROLLOUT_H_

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/env.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

// Without any answer for so long, the wait ends.
inline constexpr absl::Duration kAwaitLost = absl::Minutes(5);

// Asks once a second until the roll-out is done or stopped, and gives it as it is then; if the
// output is text, prints a line per change. A lost connection is said on env.err, and tried again.
// Aborted: another roll-out has begun, so that the end of this one is not known; Unavailable and
// others of the call: no answer for kAwaitLost, or a refusal.
absl::StatusOr<v1::Rollout> AwaitRollout(Env& env, const v1::Rollout& begun);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_AWAIT_ROLLOUT_H_
