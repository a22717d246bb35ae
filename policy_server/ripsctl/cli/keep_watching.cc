#include "policy_server/ripsctl/cli/keep_watching.h"

#include <algorithm>
#include <ostream>
#include <utility>

#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "services/rpc/status_conversion.h"

namespace rips::ripsctl {
namespace {

constexpr absl::Duration kPauseMin = absl::Milliseconds(200);
constexpr absl::Duration kPauseMax = absl::Seconds(5);

// What may be over by itself; a refusal is not.
bool Passes(const grpc::Status& status) {
  switch (status.error_code()) {
    case grpc::StatusCode::UNAVAILABLE:
    case grpc::StatusCode::RESOURCE_EXHAUSTED:
    case grpc::StatusCode::INTERNAL:
    case grpc::StatusCode::UNKNOWN:
    case grpc::StatusCode::CANCELLED:
    case grpc::StatusCode::DEADLINE_EXCEEDED:
    case grpc::StatusCode::ABORTED:
      return true;
    default:
      return false;
  }
}

}  // namespace

absl::Status KeepWatching(const WatchHooks& hooks, const WatchOnce& once) {
  absl::Duration pause = kPauseMin;
  bool connected = false;
  bool lost = false;
  while (true) {
    const grpc::Status status = once(connected, [&] {
      connected = true;
      pause = kPauseMin;
      if (std::exchange(lost, false)) hooks.connected_again();
    });
    if (status.ok() || !connected || !Passes(status)) return rpc::FromGrpc(status);
    if (!std::exchange(lost, true)) hooks.lost(status);
    if (!hooks.pause(pause)) return absl::OkStatus();
    pause = std::min(2 * pause, kPauseMax);
  }
}

absl::Status KeepWatching(Env& env, const WatchOnce& once) {
  const auto lost = [&](const grpc::Status& status) {
    env.err << "the connection is lost (" << EscapeText(status.error_message())
            << "); trying again, from where it was" << std::endl;
  };
  const auto connected_again = [&] { env.err << "connected again" << std::endl; };
  const auto pause = [](absl::Duration duration) {
    absl::SleepFor(duration);
    return true;
  };
  return KeepWatching({lost, connected_again, pause}, once);
}

}  // namespace rips::ripsctl
