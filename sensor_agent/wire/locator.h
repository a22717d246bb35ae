// Where a datagram comes from or goes to.
#ifndef RIPS_SENSOR_AGENT_WIRE_LOCATOR_H_
#define RIPS_SENSOR_AGENT_WIRE_LOCATOR_H_

#include <array>
#include <compare>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/string_view.h"

namespace rips::wire {

// An IPv6 address in network order; IPv4 as ::ffff:a.b.c.d (RFC 4291 §2.5.5.2).
struct Address {
  std::array<uint8_t, 16> bytes{};

  friend auto operator<=>(const Address&, const Address&) = default;
  template <typename H>
  friend H AbslHashValue(H h, const Address& address) {
    return H::combine_contiguous(std::move(h), address.bytes.data(), address.bytes.size());
  }

  bool v4() const;
  bool multicast() const;
  bool loopback() const;
};

struct Locator {
  Address address;
  uint16_t port = 0;

  friend auto operator<=>(const Locator&, const Locator&) = default;
  template <typename H>
  friend H AbslHashValue(H h, const Locator& locator) {
    return H::combine(std::move(h), locator.address, locator.port);
  }
};

// `octets` are 4 bytes in network order.
Address FromV4(const uint8_t* octets);
// `octets` are 16 bytes in network order; an IPv4-mapped one is that IPv4 address.
Address FromV6(const uint8_t* octets);

// "10.0.0.1:7411", "[fe80::1]:7411"; without port the same.
std::string ToString(const Address& address);
std::string ToString(const Locator& locator);

// The locators of a participant as the middleware prints them,
// "udp/239.255.0.1:7401@1,udp/10.0.0.2:41234@1". What is no UDP locator is left out, and what is
// past the first kAdvertisedMax. Any text.
inline constexpr size_t kAdvertisedMax = 64;
std::vector<Locator> ParseLocators(absl::string_view text);

// The address of the first of them that other hosts could reach, else of the first that is not
// multicast; empty if there is none.
std::string FirstAddress(absl::string_view text);

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_LOCATOR_H_
