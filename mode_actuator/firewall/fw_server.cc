#include "mode_actuator/firewall/fw_server.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "services/base/clock.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

constexpr int kInheritedFd = 3;  // SD_LISTEN_FDS_START
constexpr int kBacklog = 128;

absl::Status Failed(absl::string_view what, const std::string& path) {
  return absl::UnavailableError(
      absl::StrCat("cannot ", what, " `", path, "`: ", std::strerror(errno)));
}

absl::StatusOr<sockaddr_un> AddressOf(const std::string& path) {
  sockaddr_un address = {};
  address.sun_family = AF_UNIX;
  if (path.empty() || path.size() >= sizeof(address.sun_path)) {
    return absl::InvalidArgumentError(absl::StrCat("a socket path of ", path.size(),
                                                   " bytes; limit ", sizeof(address.sun_path) - 1));
  }
  std::memcpy(address.sun_path, path.data(), path.size());
  return address;
}

// Makes place for our socket, if what is there was left by one like us.
absl::Status RemoveStale(const std::string& path, const sockaddr_un& address) {
  struct stat info;
  if (lstat(path.c_str(), &info) != 0) {
    return errno == ENOENT ? absl::OkStatus() : Failed("look at", path);
  }
  if (!S_ISSOCK(info.st_mode)) {
    return absl::FailedPreconditionError(absl::StrCat("`", path, "` is there and is no socket"));
  }
  const UniqueFd probe(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  const auto* raw = reinterpret_cast<const sockaddr*>(&address);
  if (connect(probe.get(), raw, sizeof(address)) == 0 || errno == EAGAIN) {
    return absl::AlreadyExistsError(absl::StrCat("somebody listens at `", path, "` already"));
  }
  return unlink(path.c_str()) == 0 ? absl::OkStatus() : Failed("remove", path);
}

int Option(int fd, int name) {
  int value = -1;
  socklen_t size = sizeof(value);
  return getsockopt(fd, SOL_SOCKET, name, &value, &size) == 0 ? value : -1;
}

void Answer(int fd, const FwResponse& response) {
  const std::string packet = EncodeFwResponse(response);
  // Whoever does not read its answers does without.
  [[maybe_unused]] const ssize_t sent =
      send(fd, packet.data(), packet.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
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

absl::StatusOr<UniqueFd> ListenAt(const std::string& path, uid_t user) {
  RIPS_ASSIGN_OR_RETURN(const sockaddr_un address, AddressOf(path));
  RIPS_RETURN_IF_ERROR(RemoveStale(path, address));
  UniqueFd listener(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (listener.get() < 0) return Failed("make the socket of", path);
  // The mask makes it ours alone from its first moment.
  const mode_t mask = umask(0177);
  const int bound =
      bind(listener.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address));
  umask(mask);
  if (bound != 0) return Failed("bind", path);
  if (user != geteuid() && chown(path.c_str(), user, static_cast<gid_t>(-1)) != 0) {
    return Failed("give away", path);
  }
  if (listen(listener.get(), kBacklog) != 0) return Failed("listen at", path);
  return listener;
}

absl::StatusOr<UniqueFd> InheritedListener() {
  const char* pid = std::getenv("LISTEN_PID");
  const char* count = std::getenv("LISTEN_FDS");
  int64_t number = 0;
  if (pid == nullptr || count == nullptr || !absl::SimpleAtoi(pid, &number) || number != getpid()) {
    return UniqueFd(-1);
  }
  if (!absl::SimpleAtoi(count, &number) || number != 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("LISTEN_FDS is `", absl::string_view(count).substr(0, 20), "`, not 1"));
  }
  if (Option(kInheritedFd, SO_DOMAIN) != AF_UNIX ||
      Option(kInheritedFd, SO_TYPE) != SOCK_SEQPACKET || Option(kInheritedFd, SO_ACCEPTCONN) != 1) {
    return absl::InvalidArgumentError(
        "the inherited socket is no listening Unix socket of sequential packets");
  }
  UniqueFd listener(kInheritedFd);
  fcntl(listener.get(), F_SETFD, FD_CLOEXEC);
  fcntl(listener.get(), F_SETFL, O_NONBLOCK);
  return listener;
}

absl::StatusOr<std::unique_ptr<FwServer>> FwServer::Create(UniqueFd listener, uid_t user,
                                                           Handler handler) {
  UniqueFd stop(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (stop.get() < 0) return absl::UnavailableError("eventfd failed");
  return std::unique_ptr<FwServer>(
      new FwServer(std::move(listener), std::move(stop), user, std::move(handler)));
}

FwServer::FwServer(UniqueFd listener, UniqueFd stop, uid_t user, Handler handler)
    : listener_(std::move(listener)),
      stop_(std::move(stop)),
      user_(user),
      handler_(std::move(handler)) {}

void FwServer::Stop() {
  const uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = write(stop_.get(), &one, sizeof(one));
}

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
  UniqueFd fd(accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
  if (fd.get() < 0) return;
  ucred peer = {};
  socklen_t size = sizeof(peer);
  if (getsockopt(fd.get(), SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0 ||
      (peer.uid != 0 && peer.uid != user_)) {
    LogWarning("refused", {{"uid", absl::StrCat(peer.uid)}, {"pid", absl::StrCat(peer.pid)}});
    Answer(
        fd.get(),
        {.status = absl::PermissionDeniedError(absl::StrCat("user ", peer.uid, " may not ask"))});
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
  char packet[kFwPacketBytesMax];
  // MSG_TRUNC: the true length, also of what did not fit.
  const ssize_t got = recv(fd, packet, sizeof(packet), MSG_TRUNC);
  if (got < 0) return errno == EAGAIN || errno == EINTR;
  if (got == 0) return false;
  if (static_cast<size_t>(got) > sizeof(packet)) {
    Answer(fd, {.status = absl::InvalidArgumentError(absl::StrCat(
                    "a packet of ", got, " bytes exceeds limit ", kFwPacketBytesMax))});
    return false;
  }
  const absl::StatusOr<FwRequest> request =
      DecodeFwRequest(absl::string_view(packet, static_cast<size_t>(got)));
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
