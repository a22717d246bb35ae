#include "mode_actuator/firewall/fw_client.h"

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "services/base/clock.h"
#include "services/base/status_macros.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {
namespace {

// How soon a cancelled call returns.
constexpr int kPollMs = 20;
constexpr absl::Duration kRetryAfter = absl::Milliseconds(100);

absl::StatusOr<UniqueFd> Connect(const std::string& path) {
  sockaddr_un address = {};
  address.sun_family = AF_UNIX;
  if (path.size() >= sizeof(address.sun_path)) {
    return absl::InvalidArgumentError("the path of rips-fw's socket is too long");
  }
  std::memcpy(address.sun_path, path.data(), path.size());
  UniqueFd fd(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  const auto* raw = reinterpret_cast<const sockaddr*>(&address);
  if (fd.get() < 0 || connect(fd.get(), raw, sizeof(address)) != 0) {
    return absl::UnavailableError(
        absl::StrCat("cannot reach rips-fw at `", path, "`: ", std::strerror(errno)));
  }
  return fd;
}

bool Final(const absl::Status& status) {
  return absl::IsInvalidArgument(status) || absl::IsPermissionDenied(status) ||
         absl::IsCancelled(status);
}

}  // namespace

absl::StatusOr<FwResponse> FwClient::Call(const FwRequest& request, absl::Duration timeout,
                                          const CancelFlag& cancel) const {
  RIPS_ASSIGN_OR_RETURN(const UniqueFd fd, Connect(socket_path_));
  const std::string packet = EncodeFwRequest(request);
  // Refused at the door: the answer is there before the question.
  const bool sent = send(fd.get(), packet.data(), packet.size(), MSG_NOSIGNAL) >= 0;
  const int send_error = errno;
  const int64_t deadline_ns = BoottimeAfter(timeout);
  char answer[kFwPacketBytesMax];
  bool reset = false;
  while (true) {
    const ssize_t got = recv(fd.get(), answer, sizeof(answer), 0);
    if (got > 0) return DecodeFwResponse(absl::string_view(answer, static_cast<size_t>(got)));
    if (got < 0 && errno == ECONNRESET && !std::exchange(reset, true)) {
      // It closed without reading what we sent; what it said before that comes now.
      continue;
    }
    if (got == 0 || (errno != EAGAIN && errno != EINTR)) {
      return absl::UnavailableError(
          sent ? "rips-fw went away before it answered"
               : absl::StrCat("cannot ask rips-fw: ", std::strerror(send_error)));
    }
    const int64_t left_ns = deadline_ns - BoottimeNow();
    if (cancel.cancelled()) return absl::CancelledError("cancelled");
    if (left_ns <= 0) {
      return absl::DeadlineExceededError(
          absl::StrCat("rips-fw gave no answer within ", absl::FormatDuration(timeout)));
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
      reading = {response->status, std::move(response->observed), std::move(response->note)};
    }
    if (reading.status.ok() || Final(reading.status)) break;
  }
  return reading;
}

StepReading FwClient::CallOnce(FwVerb verb, const Step& step, const CancelFlag& cancel) const {
  const FwRequest request = {verb, std::get<FirewallStep>(step.what)};
  absl::StatusOr<FwResponse> response = Call(request, kFwCheckTimeout, cancel);
  if (!response.ok()) return {.status = response.status(), .observed = "firewall=?"};
  return {response->status, std::move(response->observed), std::move(response->note)};
}

StepReading FwClient::Check(const Step& step, const CancelFlag& cancel) {
  return CallOnce(FwVerb::kCheck, step, cancel);
}

StepReading FwClient::Drill(const Step& step, const CancelFlag& cancel) {
  return CallOnce(FwVerb::kTry, step, cancel);
}

}  // namespace rips::actuator
