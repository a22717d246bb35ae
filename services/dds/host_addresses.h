// The addresses of this host, as far as DDS depends on them.
#ifndef RIPS_SERVICES_DDS_HOST_ADDRESSES_H_
#define RIPS_SERVICES_DDS_HOST_ADDRESSES_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace rips::dds {

struct InterfaceAddress {
  std::string interface;
  // The kernel's number; an interface that is deleted and made again has another one.
  uint32_t index = 0;
  std::string address;  // as inet_ntop prints it
  bool ipv6 = false;
  // Of HostAddresses alone:
  bool loopback = false;
  bool link_local = false;
  bool multicast = false;
  bool point_to_point = false;

  // The same address of the same interface.
  bool Is(const InterfaceAddress& other) const {
    return index == other.index && interface == other.interface && address == other.address;
  }
  friend bool operator==(const InterfaceAddress&, const InterfaceAddress&) = default;
};

// Interfaces of one domain, at most; Cyclone takes no more.
inline constexpr size_t kInterfacesMax = 4;

// What a domain took when it began; Cyclone keeps it until the domain ends.
struct InterfacesInUse {
  std::vector<InterfaceAddress> addresses;
  // Cyclone chose the interface itself.
  bool automatic = false;
};

// Of interfaces that are up, in the kernel's order. The error of getifaddrs.
absl::StatusOr<std::vector<InterfaceAddress>> HostAddresses();

// `bytes`: 4, or 16 of IPv6, in network order.
std::string FormatAddress(const uint8_t* bytes, bool ipv6);

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_HOST_ADDRESSES_H_
