// Whatever bytes come as a packet: nothing is read past its end, and what is found in a part of a
// datagram is the beginning of what is found in the whole.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/strings/string_view.h"
#include "sensor_agent/wire/locator.h"
#include "sensor_agent/wire/packet_filter.h"
#include "sensor_agent/wire/rtps_parser.h"
#include "sensor_agent/wire/traffic.h"
#include "services/base/check.h"

namespace rips::wire {
namespace {

constexpr uint16_t kEthertypes[] = {0x0800, 0x86dd, 0x8100, 0x88a8};

void CheckPart(absl::string_view part, size_t size, const RtpsDatagram& whole) {
  // A copy of exactly that size, so that a read past its end is seen.
  const std::vector<char> copy(part.begin(), part.end());
  RtpsDatagram datagram;
  if (!ParseRtps({copy.data(), copy.size()}, size, datagram)) return;
  RIPS_CHECK(datagram.submessages.size() <= whole.submessages.size(), "more in less");
  RIPS_CHECK(std::equal(datagram.submessages.begin(), datagram.submessages.end(),
                        whole.submessages.begin()),
             "a part says something else");
  RIPS_CHECK(datagram.sender == whole.sender, "the sender changed");
  RIPS_CHECK(datagram.cut || datagram.submessages == whole.submessages,
             "something is missing that is not said to be");
}

void Datagram(absl::string_view bytes, TrafficTable& table) {
  RtpsDatagram datagram;
  if (!ParseRtps(bytes, bytes.size(), datagram)) return;
  RIPS_CHECK(!datagram.cut, "nothing is beyond the end");
  // A limit, since this is quadratic.
  constexpr size_t kPartsMax = 256;
  for (size_t part = 0; part < std::min(bytes.size(), kPartsMax); ++part) {
    CheckPart(bytes.substr(0, part), bytes.size(), datagram);
  }
  table.Add(datagram, Locator{}, Locator{});
}

}  // namespace
}  // namespace rips::wire

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::vector<char> bytes(data, data + size);
  const absl::string_view input(bytes.data(), bytes.size());
  rips::wire::TrafficTable table;
  rips::wire::Datagram(input, table);
  for (const uint16_t ethertype : rips::wire::kEthertypes) {
    rips::wire::UdpDatagram udp;
    if (!rips::wire::ParseIp(ethertype, input, udp)) continue;
    RIPS_CHECK(udp.bytes.size() <= udp.size, "more bytes than there are");
    rips::wire::Datagram(udp.bytes, table);
  }
  rips::wire::ParseLocators(input);
  uint64_t packets = 0;
  for (const rips::wire::Traffic& each : table.Take()) {
    packets = std::max(packets, each.last_packet);
    RIPS_CHECK(each.first_packet <= each.last_packet, "the last one before the first");
  }
  RIPS_CHECK(packets == table.counters().packets, "a datagram is nowhere");
  return 0;
}
