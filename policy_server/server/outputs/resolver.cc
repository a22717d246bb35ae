#include "policy_server/server/outputs/resolver.h"

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <memory>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::outputs {
namespace {

// More are not tried.
constexpr size_t kAddressesMax = 8;

struct Address {
  sockaddr_storage bytes = {};
  socklen_t length = 0;
};

// One question to the resolver; shared with its thread.
struct Lookup {
  std::string host;
  std::string port;
  WakeFd done;
  // Of getaddrinfo.
  int error = 0;
  std::vector<Address> found;
};

void Ask(Lookup& lookup, int flags) {
  addrinfo hints = {};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_NUMERICSERV | flags;
  addrinfo* first = nullptr;
  lookup.error = getaddrinfo(lookup.host.c_str(), lookup.port.c_str(), &hints, &first);
  if (lookup.error != 0) return;
  for (const addrinfo* each = first; each != nullptr; each = each->ai_next) {
    if (lookup.found.size() == kAddressesMax || each->ai_addrlen > sizeof(sockaddr_storage)) break;
    Address& address = lookup.found.emplace_back();
    std::memcpy(&address.bytes, each->ai_addr, each->ai_addrlen);
    address.length = each->ai_addrlen;
  }
  freeaddrinfo(first);
}

absl::StatusOr<std::vector<Address>> Resolve(const std::string& host, int port,
                                             const Deadline& deadline, const WakeFd& stop) {
  auto lookup = std::make_shared<Lookup>();
  lookup->host = host;
  lookup->port = absl::StrCat(port);
  Ask(*lookup, AI_NUMERICHOST);
  if (lookup->error != 0) {
    std::shared_ptr<void> turn = TakeLookup();
    if (turn == nullptr) {
      return absl::UnavailableError(absl::StrCat("cannot resolve ", host, ": ", kLookupsMax,
                                                 " names wait for a name server already"));
    }
    std::thread([lookup, turn = std::move(turn)] {
      Ask(*lookup, 0);
      lookup->done.Wake();
    }).detach();
    RIPS_RETURN_IF_ERROR(
        AwaitFd(lookup->done.get(), POLLIN, deadline, stop, absl::StrCat("resolving ", host)));
    lookup->done.Drain();
  }
  if (lookup->error != 0 || lookup->found.empty()) {
    return absl::UnavailableError(
        absl::StrCat("cannot resolve ", host, ": ", gai_strerror(lookup->error)));
  }
  return std::move(lookup->found);
}

absl::StatusOr<UniqueFd> ConnectOne(const Address& address, const Deadline& deadline,
                                    const WakeFd& stop) {
  const auto failed = [](int error) {
    return absl::UnavailableError(absl::StrCat("cannot connect: ", std::strerror(error)));
  };
  UniqueFd fd(
      socket(address.bytes.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, IPPROTO_TCP));
  if (fd.get() < 0) return failed(errno);
  const int on = 1;
  setsockopt(fd.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof(on));
  setsockopt(fd.get(), SOL_SOCKET, SO_KEEPALIVE, &on, sizeof(on));
  const auto* to = reinterpret_cast<const sockaddr*>(&address.bytes);
  if (connect(fd.get(), to, address.length) == 0) return fd;
  if (errno != EINPROGRESS) return failed(errno);
  RIPS_RETURN_IF_ERROR(AwaitFd(fd.get(), POLLOUT, deadline, stop, "connecting"));
  int error = 0;
  socklen_t length = sizeof(error);
  if (getsockopt(fd.get(), SOL_SOCKET, SO_ERROR, &error, &length) != 0) return failed(errno);
  if (error != 0) return failed(error);
  return fd;
}

}  // namespace

absl::Status AwaitFd(int fd, short events, const Deadline& deadline, const WakeFd& stop,
                     absl::string_view doing) {
  while (true) {
    pollfd waiting[] = {{.fd = fd, .events = events, .revents = 0},
                        {.fd = stop.get(), .events = POLLIN, .revents = 0}};
    const int ready = poll(waiting, std::size(waiting), deadline.poll_ms());
    if (ready < 0 && errno == EINTR) continue;
    if (ready < 0) return absl::UnavailableError(absl::StrCat(doing, ": ", std::strerror(errno)));
    if (waiting[1].revents != 0) return absl::CancelledError(absl::StrCat(doing, ": stopped"));
    if (ready == 0) return absl::DeadlineExceededError(absl::StrCat(doing, " took too long"));
    return absl::OkStatus();
  }
}

std::shared_ptr<void> TakeLookup() {
  static std::atomic<int> taken = 0;
  if (++taken > kLookupsMax) {
    --taken;
    return nullptr;
  }
  return {&taken, [](void*) { --taken; }};
}

absl::StatusOr<UniqueFd> ConnectTo(const std::string& host, int port, const Deadline& deadline,
                                   const WakeFd& stop) {
  RIPS_ASSIGN_OR_RETURN(const std::vector<Address> addresses, Resolve(host, port, deadline, stop));
  absl::Status status;
  for (size_t i = 0; i < addresses.size(); ++i) {
    const Deadline share(deadline.left() / static_cast<int64_t>(addresses.size() - i));
    absl::StatusOr<UniqueFd> fd = ConnectOne(addresses[i], share, stop);
    if (fd.ok() || absl::IsCancelled(fd.status())) return fd;
    status = fd.status();
  }
  return status;
}

}  // namespace rips::outputs
