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

absl::Status KeepWatching(Env& env, const WatchOnce& once) {
  absl::Duration pause = kPauseMin;
  bool connected = false;
  bool lost = false;
  while (true) {
    const grpc::Status status = once(connected, [&] {
      connected = true;
      pause = kPauseMin;
      if (std::exchange(lost, false)) env.err << "connected again" << std::endl;
    });
    if (status.ok() || !connected || !Passes(status)) return rpc::FromGrpc(status);
    if (!std::exchange(lost, true)) {
      env.err << "the connection is lost (" << EscapeText(status.error_message())
              << "); trying again, from where it was" << std::endl;
    }
    absl::SleepFor(pause);
    pause = std::min(2 * pause, kPauseMax);
  }
}

}  // namespace rips::ripsctl
