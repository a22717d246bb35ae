// A watch that goes on when its connection is lost.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_KEEP_WATCHING_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_KEEP_WATCHING_H_

#include <functional>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "grpcpp/client_context.h"
#include "grpcpp/support/status.h"
#include "policy_server/ripsctl/cli/env.h"
#include "policy_server/ripsctl/cli/reader_watch.h"
#include "policy_server/ripsctl/cli/server_expiry.h"

namespace rips::ripsctl {

// One stream of the watch, to its end. `again`: there was one before, so that the call waits for
// the connection (a channel makes progress only while a call waits for it: one that fails fast, and
// a pause, would leave a new connection's handshake undone for ever). Calls `heard` for what comes.
using WatchOnce = std::function<grpc::Status(bool again, const std::function<void()>& heard)>;

// What a watch says and asks of its command; each is set.
struct WatchHooks {
  // The connection is lost, once until it is there again.
  std::function<void(const grpc::Status&)> lost;
  std::function<void()> connected_again;
  // Waits before the next attempt. False ends the watch, which then came to OK.
  std::function<bool(absl::Duration)> pause;
};

// Until a stream ends well, or with how it is refused or the first one cannot be begun.
absl::Status KeepWatching(const WatchHooks& hooks, const WatchOnce& once);

// The same; says on env.err that the connection is lost, and that it is there again.
absl::Status KeepWatching(Env& env, const WatchOnce& once);

// The same for streams of messages: `open` makes the call with a context, `on_message` takes what
// comes. Ends well when env.out can no longer be written, or is no longer read.
template <typename Message, typename Open, typename OnMessage>
absl::Status Watch(Env& env, const Open& open, const OnMessage& on_message) {
  return KeepWatching(env, [&](bool again, const std::function<void()>& heard) {
    grpc::ClientContext context;
    context.set_wait_for_ready(again);
    const auto reader = open(&context);
    ServerExpiry expiry(&context);
    {
      const ReaderWatch out_reader(env.out_fd, [&] { context.TryCancel(); });
      Message message;
      while (env.out.ok() && reader->Read(&message)) {
        heard();
        expiry.Received();
        on_message(message);
      }
      if (out_reader.gone()) env.out.Close();
      if (!env.out.ok()) context.TryCancel();
    }
    const grpc::Status end = expiry.End(reader->Finish());
    return env.out.ok() ? end : grpc::Status::OK;
  });
}

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_KEEP_WATCHING_H_
