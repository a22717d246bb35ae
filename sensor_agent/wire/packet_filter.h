// What the kernel hands to the tap: a classic BPF program, and the way through the IP headers of
// what passed it.
#ifndef RIPS_SENSOR_AGENT_WIRE_PACKET_FILTER_H_
#define RIPS_SENSOR_AGENT_WIRE_PACKET_FILTER_H_

#include <linux/filter.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/strings/string_view.h"
#include "sensor_agent/wire/locator.h"

namespace rips::wire {

// Inclusive; empty if last < first.
struct PortRange {
  uint16_t first = 1;
  uint16_t last = 0;

  friend bool operator==(const PortRange&, const PortRange&) = default;
};

// The ports of a DDS domain (DDSI-RTPS 2.5 §9.6.2.3), 7400 + 250 x domain and the 249 after it, as
// far as there are ports. Empty for a domain above 232.
PortRange PortsOfDomain(uint32_t domain);

// For a packet socket of type SOCK_DGRAM on all protocols. Passes UDP over IPv4 and IPv6, but no
// fragments after the first, to a port of one of `ranges`, that begins with RTPS or RTPX; also
// behind one VLAN tag that the kernel left on. IPv6 packets with extension headers other than a
// fragment's pass unseen: they are rare, and ParseIp looks into them. What leaves by loopback does
// not pass, since it comes in there again. At most 4 ranges; empty ones are left out.
std::vector<sock_filter> RtpsFilter(const std::vector<PortRange>& ranges);

// One datagram, as far as it is at hand.
struct UdpDatagram {
  Locator source;
  Locator to;
  // First bytes of the payload, a view into what was parsed.
  absl::string_view bytes;
  // Bytes of the whole payload; of a fragmented one as its UDP header says.
  size_t size = 0;
};

// `packet` are the first bytes of a packet, from behind the link header; `ethertype` is what that
// says. False if it holds no UDP datagram, or not its beginning.
bool ParseIp(uint16_t ethertype, absl::string_view packet, UdpDatagram& datagram);

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_PACKET_FILTER_H_
