#include "services/dds/host_addresses.h"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cerrno>
#include <memory>

#include "absl/status/status.h"

namespace rips::dds {

std::string FormatAddress(const uint8_t* bytes, bool ipv6) {
  char text[INET6_ADDRSTRLEN];
  return inet_ntop(ipv6 ? AF_INET6 : AF_INET, bytes, text, sizeof text) == nullptr ? "" : text;
}

absl::StatusOr<std::vector<InterfaceAddress>> HostAddresses() {
  ifaddrs* list = nullptr;
  if (getifaddrs(&list) != 0) return absl::ErrnoToStatus(errno, "reading the host's addresses");
  const std::unique_ptr<ifaddrs, void (*)(ifaddrs*)> freed(list, freeifaddrs);
  std::vector<InterfaceAddress> all;
  for (const ifaddrs* each = list; each != nullptr; each = each->ifa_next) {
    if (each->ifa_addr == nullptr || (each->ifa_flags & IFF_UP) == 0) continue;
    InterfaceAddress one{.interface = each->ifa_name,
                         .loopback = (each->ifa_flags & IFF_LOOPBACK) != 0,
                         .multicast = (each->ifa_flags & IFF_MULTICAST) != 0,
                         .point_to_point = (each->ifa_flags & IFF_POINTOPOINT) != 0};
    if (each->ifa_addr->sa_family == AF_INET) {
      const auto* v4 = reinterpret_cast<const sockaddr_in*>(each->ifa_addr);
      one.address = FormatAddress(reinterpret_cast<const uint8_t*>(&v4->sin_addr), false);
    } else if (each->ifa_addr->sa_family == AF_INET6) {
      const auto* v6 = reinterpret_cast<const sockaddr_in6*>(each->ifa_addr);
      one.ipv6 = true;
      one.link_local = IN6_IS_ADDR_LINKLOCAL(&v6->sin6_addr);
      one.address = FormatAddress(v6->sin6_addr.s6_addr, true);
    } else {
      continue;
    }
    one.index = if_nametoindex(each->ifa_name);
    all.push_back(std::move(one));
  }
  return all;
}

}  // namespace rips::dds
