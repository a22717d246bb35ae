#include "mode_actuator/helpers/fw/fw_server.h"

#include <poll.h>

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/clock.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

void Answer(int fd, const FwResponse& response) {
  // A client that does not read its answers loses them.
  SendPacket(fd, EncodeFwResponse(response)).IgnoreError();
}

absl::string_view VerbName(FwVerb verb) {
  switch (verb) {
    case FwVerb::kEnter:
      return "enter";
    case FwVerb::kCheck:
      return "check";
    case FwVerb::kTry:
      return "try";
    case FwVerb::kStatus:
      return "status";
  }
  return "?";
}

}  // namespace

FwServer::FwServer(UniqueFd listener, uid_t user, Handler handler)
    : listener_(std::move(listener)), user_(user), handler_(std::move(handler)) {}

void FwServer::Run() {
  while (true) {
    std::vector<pollfd> fds = {{stop_.get(), POLLIN, 0}, {listener_.get(), POLLIN, 0}};
    for (const Connection& each : connections_) fds.push_back({each.fd.get(), POLLIN, 0});
    poll(fds.data(), fds.size(), connections_.empty() ? -1 : 1000);
    if (fds[0].revents != 0) return;
    const int64_t now_ns = BoottimeNow();
    for (size_t i = 0; i < connections_.size(); ++i) {
      Connection& each = connections_[i];
      if (fds[i + 2].revents != 0) {
        each.last_ns = now_ns;
        if (!Serve(each.fd.get())) each.fd.Reset();
      } else if (now_ns - each.last_ns > absl::ToInt64Nanoseconds(kFwIdleMax)) {
        each.fd.Reset();
      }
    }
    std::erase_if(connections_, [](const Connection& each) { return each.fd.get() < 0; });
    if (fds[1].revents != 0) Accept();
  }
}

void FwServer::Accept() {
  Accepted accepted = AcceptFrom(listener_.get(), user_);
  if (accepted.fd.get() < 0) return;
  UniqueFd fd = std::move(accepted.fd);
  if (!accepted.peer.ok()) {
    LogWarning("refused", {{"why", accepted.peer.message()}});
    Answer(fd.get(), {.status = accepted.peer});
    return;
  }
  if (connections_.size() >= kFwConnectionsMax) {
    Answer(fd.get(), {.status = absl::ResourceExhaustedError(
                          absl::StrCat("connections exceed limit ", kFwConnectionsMax))});
    return;
  }
  connections_.push_back({std::move(fd), BoottimeNow()});
}

bool FwServer::Serve(int fd) {
  const absl::StatusOr<std::string> packet = ReceivePacket(fd, kFwPacketBytesMax);
  if (absl::IsUnavailable(packet.status())) return true;
  if (absl::IsResourceExhausted(packet.status())) {
    Answer(fd, {.status = absl::InvalidArgumentError(packet.status().message())});
  }
  if (!packet.ok()) return false;
  const absl::StatusOr<FwRequest> request = DecodeFwRequest(*packet);
  if (!request.ok()) {
    LogWarning("malformed request", {{"why", request.status().message()}});
    Answer(fd, {.status = request.status()});
    return false;
  }
  const FwResponse response = handler_(*request);
  if (!response.status.ok()) {
    LogWarning("failed", {{"verb", VerbName(request->verb)}, {"why", response.status.message()}});
  } else if (request->verb == FwVerb::kEnter) {
    LogInfo("entered", {{"observed", response.observed}, {"note", response.note}});
  }
  Answer(fd, response);
  return true;
}

}  // namespace rips::actuator
