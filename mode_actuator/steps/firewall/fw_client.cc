#include "mode_actuator/steps/firewall/fw_client.h"

#include <poll.h>

#include <algorithm>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "services/base/clock.h"
#include "services/base/status_macros.h"
#include "services/local_socket/helper_socket.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {
namespace {

// How soon a cancelled call returns.
constexpr int kPollMs = 20;
constexpr absl::Duration kRetryAfter = absl::Milliseconds(100);

bool Final(const absl::Status& status) {
  return absl::IsInvalidArgument(status) || absl::IsPermissionDenied(status) ||
         absl::IsCancelled(status);
}

}  // namespace

absl::StatusOr<FwResponse> FwClient::Call(const FwRequest& request, absl::Duration timeout,
                                          const CancelFlag& cancel) const {
  RIPS_ASSIGN_OR_RETURN(const UniqueFd fd, door_.Connect());
  // Refused at the door: the answer is there before the question.
  const absl::Status sent = SendPacket(fd.get(), EncodeFwRequest(request));
  const int64_t deadline_ns = BoottimeAfter(timeout);
  bool reset = false;
  while (true) {
    const absl::StatusOr<std::string> answer = ReceivePacket(fd.get(), kFwPacketBytesMax);
    if (answer.ok()) return DecodeFwResponse(*answer);
    if (absl::IsAborted(answer.status()) && !std::exchange(reset, true)) continue;
    if (!absl::IsUnavailable(answer.status())) {
      return absl::UnavailableError(sent.ok()
                                        ? "rips-fw went away before it answered"
                                        : absl::StrCat("cannot ask rips-fw: ", sent.message()));
    }
    const int64_t left_ns = deadline_ns - BoottimeNow();
    if (cancel.cancelled()) return absl::CancelledError("cancelled");
    if (left_ns <= 0) {
      return absl::DeadlineExceededError(
          absl::StrCat("rips-fw did not answer within ", absl::FormatDuration(timeout)));
    }
    pollfd poll_fd = {fd.get(), POLLIN, 0};
    poll(&poll_fd, 1, static_cast<int>(std::min<int64_t>(kPollMs, left_ns / kNanosPerMilli + 1)));
  }
}

StepReading FwClient::Enter(const Step& step, absl::Duration timeout, int retries,
                            const CancelFlag& cancel) {
  const FwRequest request = {FwVerb::kEnter, std::get<FirewallStep>(step.what)};
  StepReading reading;
  for (int attempt = 0; attempt <= retries; ++attempt) {
    if (attempt > 0 && cancel.WaitFor(kRetryAfter)) return {absl::CancelledError("cancelled")};
    absl::StatusOr<FwResponse> response = Call(request, timeout, cancel);
    if (!response.ok()) {
      reading = {.status = response.status(), .observed = "firewall=?"};
    } else {
      reading = {response->status, std::move(response->observed), std::move(response->note), {}};
    }
    if (reading.status.ok() || Final(reading.status)) break;
  }
  return reading;
}

StepReading FwClient::CallOnce(FwVerb verb, const Step& step, const CancelFlag& cancel) const {
  const FwRequest request = {verb, std::get<FirewallStep>(step.what)};
  absl::StatusOr<FwResponse> response = Call(request, kFwCheckTimeout, cancel);
  if (!response.ok()) return {.status = response.status(), .observed = "firewall=?"};
  return {response->status, std::move(response->observed), std::move(response->note),
          std::move(response->dropped)};
}

StepReading FwClient::Check(const Step& step, const CancelFlag& cancel) {
  return CallOnce(FwVerb::kCheck, step, cancel);
}

StepReading FwClient::Drill(const Step& step, const CancelFlag& cancel) {
  return CallOnce(FwVerb::kTry, step, cancel);
}

}  // namespace rips::actuator
