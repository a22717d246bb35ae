// Whatever bytes come as a packet: nothing is read past its end, what is found in a part of a
// datagram is the beginning of what is found in the whole, and the same datagram twice has the same
// contents.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "absl/strings/string_view.h"
#include "sensor_agent/wire/locator.h"
#include "sensor_agent/wire/packet_filter.h"
#include "sensor_agent/wire/reception.h"
#include "sensor_agent/wire/rtps_parser.h"
#include "sensor_agent/wire/traffic.h"
#include "sensor_agent/wire/writer_numbers.h"
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
  for (size_t i = 0; i < datagram.submessages.size(); ++i) {
    RtpsSubmessage part_of = whole.submessages[i];
    // The last one may be cut, and its inline QoS.
    const RtpsSubmessage& found = datagram.submessages[i];
    if (found.content_unknown) {
      part_of.content_unknown = true;
      part_of.content = {};
      part_of.content_size = part_of.fragment = 0;
    }
    part_of.content = part_of.content.substr(0, found.content.size());
    RIPS_CHECK(found == part_of, "a part says something else");
    RIPS_CHECK(found.content.size() <= found.content_size, "more content than there is");
  }
  RIPS_CHECK(datagram.sender == whole.sender, "the sender changed");
  RIPS_CHECK(datagram.cut || datagram.submessages.size() == whole.submessages.size(),
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
  table.Add(datagram, Locator{}, Locator{}, 0);
  RtpsDatagram again;
  ParseRtps(bytes, bytes.size(), again);
  RIPS_CHECK(again == datagram, "the same bytes say something else");
}

}  // namespace
}  // namespace rips::wire

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::vector<char> bytes(data, data + size);
  const absl::string_view input(bytes.data(), bytes.size());
  rips::wire::TrafficTable table({.low = 1}, {.content_buckets_log2 = 4});
  rips::wire::Datagram(input, table);
  for (const uint16_t ethertype : rips::wire::kEthertypes) {
    rips::wire::UdpDatagram udp;
    if (!rips::wire::ParseIp(ethertype, input, udp)) continue;
    RIPS_CHECK(udp.bytes.size() <= udp.size, "more bytes than there are");
    rips::wire::Datagram(udp.bytes, table);
  }
  rips::wire::ParseLocators(input);
  uint64_t packets = 0;
  rips::wire::WriterNumbers numbers;
  rips::wire::Reception reception(0);
  for (const rips::wire::Traffic& each : table.Take()) {
    numbers.Take(each, 0);
    reception.OnWire(each, 0);
    packets = std::max(packets, each.last_packet);
    RIPS_CHECK(each.first_packet <= each.last_packet, "the last one before the first");
    RIPS_CHECK(each.data_least <= each.data_last, "the least above the greatest");
    RIPS_CHECK(each.numbers.count() <= each.data + each.data_frag, "more numbers than data");
  }
  reception.Missing(std::numeric_limits<int64_t>::max());
  RIPS_CHECK(packets == table.counters().packets, "a datagram is nowhere");
  return 0;
}
