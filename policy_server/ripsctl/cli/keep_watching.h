// A watch that goes on when its connection is lost.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_KEEP_WATCHING_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_KEEP_WATCHING_H_

#include <functional>

#include "grpcpp/support/status.h"
#include "policy_server/ripsctl/cli/env.h"

namespace rips::ripsctl {

// One stream of the watch, to its end. `again`: there was one before, so that the call waits for
// the connection (a channel makes progress only while a call waits for it: one that fails fast, and
// a pause, would leave a new connection's handshake undone for ever). Calls `heard` for what comes.
using WatchOnce = std::function<grpc::Status(bool again, const std::function<void()>& heard)>;

// Until a stream ends well, or is refused, or the first one cannot be begun. Says on env.err that
// the connection is lost, and that it is there again.
ExitCode KeepWatching(Env& env, const WatchOnce& once);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_KEEP_WATCHING_H_
