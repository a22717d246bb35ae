#include "services/local_socket/helper_socket.h"

#include <fcntl.h>
#include <pwd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

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
    return errno == ENOENT ? absl::OkStatus() : Failed("read", path);
  }
  if (!S_ISSOCK(info.st_mode)) {
    return absl::FailedPreconditionError(absl::StrCat("`", path, "` is there and is no socket"));
  }
  const UniqueFd probe(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  const auto* raw = reinterpret_cast<const sockaddr*>(&address);
  if (connect(probe.get(), raw, sizeof(address)) == 0 || errno == EAGAIN) {
    return absl::AlreadyExistsError(
        absl::StrCat("another process listens at `", path, "` already"));
  }
  return unlink(path.c_str()) == 0 ? absl::OkStatus() : Failed("remove", path);
}

int Option(int fd, int name) {
  int value = -1;
  socklen_t size = sizeof(value);
  return getsockopt(fd, SOL_SOCKET, name, &value, &size) == 0 ? value : -1;
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

absl::StatusOr<UniqueFd> ListenForHelper(const std::string& path, uid_t user) {
  RIPS_ASSIGN_OR_RETURN(UniqueFd inherited, InheritedListener());
  if (inherited.get() >= 0) return inherited;
  return ListenAt(path, user);
}

absl::StatusOr<uid_t> FindUser(const std::string& user, absl::string_view key) {
  uint32_t number = 0;
  if (absl::SimpleAtoi(user, &number)) return static_cast<uid_t>(number);
  const passwd* entry = getpwnam(user.c_str());
  if (entry != nullptr) return entry->pw_uid;
  return absl::InvalidArgumentError(
      absl::StrCat(key, ": no user `", absl::CHexEscape(user.substr(0, 100)), "`"));
}

Accepted AcceptFrom(int listener, uid_t user) {
  Accepted accepted;
  accepted.fd = UniqueFd(accept4(listener, nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
  if (accepted.fd.get() < 0) return accepted;
  ucred peer = {};
  socklen_t size = sizeof(peer);
  if (getsockopt(accepted.fd.get(), SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0) {
    accepted.peer = absl::PermissionDeniedError("the peer of the socket is unknown");
  } else if (peer.uid != 0 && peer.uid != user) {
    accepted.peer = absl::PermissionDeniedError(absl::StrCat("user ", peer.uid, " may not ask"));
  }
  return accepted;
}

absl::StatusOr<UniqueFd> ConnectToHelper(const std::string& path, absl::string_view helper) {
  RIPS_ASSIGN_OR_RETURN(const sockaddr_un address, AddressOf(path));
  UniqueFd fd(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  const auto* raw = reinterpret_cast<const sockaddr*>(&address);
  if (fd.get() < 0 || connect(fd.get(), raw, sizeof(address)) != 0) {
    return absl::UnavailableError(
        absl::StrCat("cannot reach ", helper, " at `", path, "`: ", std::strerror(errno)));
  }
  return fd;
}

absl::StatusOr<std::string> ReceivePacket(int fd, size_t limit) {
  std::string packet(limit, '\0');
  // MSG_TRUNC: the true length, also of what did not fit.
  const ssize_t got = recv(fd, packet.data(), packet.size(), MSG_TRUNC | MSG_DONTWAIT);
  if (got < 0) {
    if (errno == EAGAIN || errno == EINTR) return absl::UnavailableError("no packet");
    if (errno == ECONNRESET)
      return absl::AbortedError("the peer closed before it read every packet");
    return absl::OutOfRangeError(std::strerror(errno));
  }
  if (got == 0) return absl::OutOfRangeError("closed");
  if (static_cast<size_t>(got) > limit) {
    return absl::ResourceExhaustedError(
        absl::StrCat("a packet of ", got, " bytes exceeds limit ", limit));
  }
  packet.resize(static_cast<size_t>(got));
  return packet;
}

absl::Status SendPacket(int fd, absl::string_view packet) {
  if (send(fd, packet.data(), packet.size(), MSG_NOSIGNAL | MSG_DONTWAIT) >= 0) {
    return absl::OkStatus();
  }
  if (errno == EAGAIN || errno == EINTR || errno == ENOBUFS) {
    return absl::UnavailableError("no room");
  }
  return absl::AbortedError(std::strerror(errno));
}

}  // namespace rips::actuator
