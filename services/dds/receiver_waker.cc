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

// 0 = it is none, or not bound to every address.
in_port_t PortOfEveryAddress(int descriptor) {
  int type = 0;
  socklen_t size = sizeof type;
  if (getsockopt(descriptor, SOL_SOCKET, SO_TYPE, &type, &size) != 0 || type != SOCK_DGRAM) {
    return 0;
  }
  sockaddr_in name = {};
  size = sizeof name;
  if (getsockname(descriptor, reinterpret_cast<sockaddr*>(&name), &size) != 0) return 0;
  return name.sin_family == AF_INET && name.sin_addr.s_addr == htonl(INADDR_ANY) ? name.sin_port
                                                                                 : in_port_t{0};
}

void WakeReceivers() {
  const UniqueFd from(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  for (const int descriptor : Descriptors()) {
    const in_port_t port = PortOfEveryAddress(descriptor);
    if (port == 0) continue;
    sockaddr_in to = {};
    to.sin_family = AF_INET;
    to.sin_port = port;
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    const char octet = 0;
    sendto(from.get(), &octet, sizeof octet, 0, reinterpret_cast<const sockaddr*>(&to), sizeof to);
  }
}

}  // namespace

ReceiverWaker::ReceiverWaker(absl::Duration after)
    : ticker_(after, [] {
        WakeReceivers();
        return kAgain;
      }) {}

}  // namespace rips::dds
