#include "services/dds/receiver_waker.h"

#include <netinet/in.h>
#include <sys/socket.h>

#include <cstdlib>
#include <filesystem>
#include <system_error>
#include <vector>

#include "services/runtime/unique_fd.h"

namespace rips::dds {
namespace {

constexpr absl::Duration kAgain = absl::Milliseconds(200);

std::vector<int> Descriptors() {
  std::vector<int> all;
  std::error_code error;
  for (std::filesystem::directory_iterator it("/proc/self/fd", error), end; !error && it != end;
       it.increment(error)) {
    all.push_back(std::atoi(it->path().filename().c_str()));
  }
  return all;
}

struct EveryAddress {
  int family = AF_INET;
  in_port_t port = 0;  // 0 = it is no such socket, or not bound to every address
};

EveryAddress PortOfEveryAddress(int descriptor) {
  int type = 0;
  socklen_t size = sizeof type;
  if (getsockopt(descriptor, SOL_SOCKET, SO_TYPE, &type, &size) != 0 || type != SOCK_DGRAM) {
    return {};
  }
  sockaddr_storage name = {};
  size = sizeof name;
  if (getsockname(descriptor, reinterpret_cast<sockaddr*>(&name), &size) != 0) return {};
  if (name.ss_family == AF_INET) {
    const auto& v4 = reinterpret_cast<const sockaddr_in&>(name);
    if (v4.sin_addr.s_addr == htonl(INADDR_ANY)) return {AF_INET, v4.sin_port};
  } else if (name.ss_family == AF_INET6) {
    const auto& v6 = reinterpret_cast<const sockaddr_in6&>(name);
    if (IN6_IS_ADDR_UNSPECIFIED(&v6.sin6_addr)) return {AF_INET6, v6.sin6_port};
  }
  return {};
}

void WakeReceivers() {
  for (const int descriptor : Descriptors()) {
    const auto [family, port] = PortOfEveryAddress(descriptor);
    if (port == 0) continue;
    const UniqueFd from(socket(family, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
    const char octet = 0;
    if (family == AF_INET) {
      sockaddr_in to = {};
      to.sin_family = AF_INET;
      to.sin_port = port;
      to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
      sendto(from.get(), &octet, sizeof octet, 0, reinterpret_cast<const sockaddr*>(&to),
             sizeof to);
    } else {
      sockaddr_in6 to = {};
      to.sin6_family = AF_INET6;
      to.sin6_port = port;
      to.sin6_addr = in6addr_loopback;
      sendto(from.get(), &octet, sizeof octet, 0, reinterpret_cast<const sockaddr*>(&to),
             sizeof to);
    }
  }
}

}  // namespace

ReceiverWaker::ReceiverWaker(absl::Duration after)
    : ticker_(after, [] {
        WakeReceivers();
        return kAgain;
      }) {}

}  // namespace rips::dds
