#include "sensor_agent/wire/packet_filter.h"

#include <linux/if_arp.h>
#include <linux/if_ether.h>
#include <linux/if_packet.h>
#include <netinet/in.h>

#include <algorithm>
#include <limits>

#include "services/base/check.h"

namespace rips::wire {

namespace {

constexpr uint32_t kPortBase = 7'400;
constexpr uint32_t kPortsPerDomain = 250;
constexpr uint32_t kDomainMax = 232;
constexpr size_t kRangesMax = 4;

constexpr uint32_t kRtps = 0x52545053;  // "RTPS"
constexpr uint32_t kRtpx = 0x52545058;  // "RTPX"
constexpr uint32_t kVlanBytes = 4;
constexpr uint32_t kUdpBytes = 8;
constexpr uint32_t kV4Bytes = 20;
constexpr uint32_t kV6Bytes = 40;
constexpr uint32_t kV6FragmentBytes = 8;
constexpr size_t kV6ExtensionsMax = 8;
// Where in the IP headers.
constexpr uint32_t kV4FragmentAt = 6;
constexpr uint32_t kV4ProtocolAt = 9;
constexpr uint32_t kV6NextAt = 6;
// Of the two bytes with flags and offset: the offset.
constexpr uint32_t kV4OffsetMask = 0x1fff;
constexpr uint32_t kV6OffsetMask = 0xfff8;

// The instructions that say yes and no are the last two; jumps there are set at the end, because
// they count from where they stand.
constexpr uint8_t kToNo = 0xff;
constexpr uint8_t kToYes = 0xfe;

class Program {
 public:
  void Load(uint16_t size, uint32_t at) { Add(BPF_LD | size | BPF_ABS, at); }
  void LoadIndexed(uint16_t size, uint32_t at) { Add(BPF_LD | size | BPF_IND, at); }
  void Ancillary(uint32_t field) { Load(BPF_W, static_cast<uint32_t>(SKF_AD_OFF) + field); }
  void Add(int code, uint32_t k) {
    instructions_.push_back({.code = static_cast<uint16_t>(code), .jt = 0, .jf = 0, .k = k});
  }
  // The accumulator against `k`. A jump skips so many instructions.
  void Jump(int condition, uint32_t k, uint8_t if_true, uint8_t if_false) {
    instructions_.push_back({.code = static_cast<uint16_t>(BPF_JMP | condition | BPF_K),
                             .jt = if_true,
                             .jf = if_false,
                             .k = k});
  }
  // The same, where the way to go if true is told later by Land.
  size_t JumpAhead(int condition, uint32_t k) {
    Jump(condition, k, 0, 0);
    return instructions_.size() - 1;
  }
  void Land(size_t jump) {
    instructions_[jump].jt = static_cast<uint8_t>(instructions_.size() - jump - 1);
  }

  std::vector<sock_filter> Finish() && {
    const size_t no = instructions_.size();
    Add(BPF_RET | BPF_K, 0);
    Add(BPF_RET | BPF_K, std::numeric_limits<uint32_t>::max());
    for (size_t i = 0; i < no; ++i) {
      sock_filter& each = instructions_[i];
      if (BPF_CLASS(each.code) != BPF_JMP) continue;
      for (uint8_t* way : {&each.jt, &each.jf}) {
        if (*way < kToYes) continue;
        const size_t target = *way == kToNo ? no : no + 1;
        RIPS_CHECK(target - i - 1 < kToYes, "the packet filter is too long for its jumps");
        *way = static_cast<uint8_t>(target - i - 1);
      }
    }
    return std::move(instructions_);
  }

 private:
  std::vector<sock_filter> instructions_;
};

// The UDP header begins at X + `at`.
void Udp(Program& program, uint32_t at, const std::vector<PortRange>& ranges) {
  program.LoadIndexed(BPF_W, at + kUdpBytes);
  program.Jump(BPF_JEQ, kRtps, 1, 0);
  program.Jump(BPF_JEQ, kRtpx, 0, kToNo);
  program.LoadIndexed(BPF_H, at + 2);
  for (const PortRange& range : ranges) {
    program.Jump(BPF_JGE, range.first, 0, 1);
    program.Jump(BPF_JGT, range.last, 0, kToYes);
  }
  program.Jump(BPF_JEQ, 0, kToNo, kToNo);
}

void V4(Program& program, uint32_t base, const std::vector<PortRange>& ranges) {
  program.Load(BPF_B, base + kV4ProtocolAt);
  program.Jump(BPF_JEQ, IPPROTO_UDP, 0, kToNo);
  program.Load(BPF_H, base + kV4FragmentAt);
  program.Jump(BPF_JSET, kV4OffsetMask, kToNo, 0);
  program.Add(BPF_LDX | BPF_B | BPF_MSH, base);
  Udp(program, base, ranges);
}

void V6(Program& program, uint32_t base, const std::vector<PortRange>& ranges) {
  program.Add(BPF_LDX | BPF_W | BPF_IMM, kV6Bytes);
  program.Load(BPF_B, base + kV6NextAt);
  const size_t udp = program.JumpAhead(BPF_JEQ, IPPROTO_UDP);
  program.Jump(BPF_JEQ, IPPROTO_HOPOPTS, kToYes, 0);
  program.Jump(BPF_JEQ, IPPROTO_ROUTING, kToYes, 0);
  program.Jump(BPF_JEQ, IPPROTO_DSTOPTS, kToYes, 0);
  program.Jump(BPF_JEQ, IPPROTO_FRAGMENT, 0, kToNo);
  program.Load(BPF_H, base + kV6Bytes + 2);
  program.Jump(BPF_JSET, kV6OffsetMask, kToNo, 0);
  program.Load(BPF_B, base + kV6Bytes);
  program.Jump(BPF_JEQ, IPPROTO_UDP, 0, kToYes);
  program.Add(BPF_LDX | BPF_W | BPF_IMM, kV6Bytes + kV6FragmentBytes);
  program.Land(udp);
  Udp(program, base, ranges);
}

uint16_t U16(absl::string_view bytes, size_t at) {
  return static_cast<uint16_t>(static_cast<uint8_t>(bytes[at]) * 256 +
                               static_cast<uint8_t>(bytes[at + 1]));
}

const uint8_t* Octets(absl::string_view bytes, size_t at) {
  return reinterpret_cast<const uint8_t*>(bytes.data()) + at;
}

// `packet` begins with the UDP header.
bool ParseUdp(absl::string_view packet, UdpDatagram& datagram) {
  if (packet.size() < kUdpBytes) return false;
  datagram.source.port = U16(packet, 0);
  datagram.to.port = U16(packet, 2);
  const size_t length = U16(packet, 4);
  if (length < kUdpBytes) return false;
  datagram.size = length - kUdpBytes;
  datagram.bytes = packet.substr(kUdpBytes, datagram.size);
  return true;
}

bool ParseV4(absl::string_view packet, UdpDatagram& datagram) {
  if (packet.size() < kV4Bytes) return false;
  const size_t header = size_t{static_cast<uint8_t>(packet[0])} % 16 * 4;
  if (header < kV4Bytes || packet.size() < header) return false;
  if (packet[kV4ProtocolAt] != IPPROTO_UDP) return false;
  if ((U16(packet, kV4FragmentAt) & kV4OffsetMask) != 0) return false;
  datagram.source.address = FromV4(Octets(packet, 12));
  datagram.to.address = FromV4(Octets(packet, 16));
  return ParseUdp(packet.substr(header), datagram);
}

bool ParseV6(absl::string_view packet, UdpDatagram& datagram) {
  if (packet.size() < kV6Bytes) return false;
  datagram.source.address = FromV6(Octets(packet, 8));
  datagram.to.address = FromV6(Octets(packet, 24));
  uint8_t next = static_cast<uint8_t>(packet[kV6NextAt]);
  packet.remove_prefix(kV6Bytes);
  for (size_t i = 0; i < kV6ExtensionsMax; ++i) {
    if (next == IPPROTO_UDP) return ParseUdp(packet, datagram);
    if (packet.size() < kV6FragmentBytes) return false;
    size_t length = kV6FragmentBytes;
    if (next == IPPROTO_FRAGMENT) {
      if ((U16(packet, 2) & kV6OffsetMask) != 0) return false;
    } else if (next == IPPROTO_HOPOPTS || next == IPPROTO_ROUTING || next == IPPROTO_DSTOPTS) {
      length += size_t{static_cast<uint8_t>(packet[1])} * 8;
    } else {
      return false;
    }
    if (packet.size() < length) return false;
    next = static_cast<uint8_t>(packet[0]);
    packet.remove_prefix(length);
  }
  return false;
}

}  // namespace

PortRange PortsOfDomain(uint32_t domain) {
  if (domain > kDomainMax) return {};
  const uint32_t first = kPortBase + kPortsPerDomain * domain;
  const uint32_t last =
      std::min<uint32_t>(first + kPortsPerDomain - 1, std::numeric_limits<uint16_t>::max());
  return {.first = static_cast<uint16_t>(first), .last = static_cast<uint16_t>(last)};
}

std::vector<sock_filter> RtpsFilter(const std::vector<PortRange>& ranges) {
  std::vector<PortRange> some;
  for (const PortRange& each : ranges) {
    if (each.first <= each.last) some.push_back(each);
  }
  RIPS_CHECK(some.size() <= kRangesMax, "too many port ranges");
  Program program;
  program.Ancillary(SKF_AD_PKTTYPE);
  program.Jump(BPF_JEQ, PACKET_OUTGOING, 0, 2);
  program.Ancillary(SKF_AD_HATYPE);
  program.Jump(BPF_JEQ, ARPHRD_LOOPBACK, kToNo, 0);

  program.Ancillary(SKF_AD_PROTOCOL);
  const size_t v4 = program.JumpAhead(BPF_JEQ, ETH_P_IP);
  const size_t v6 = program.JumpAhead(BPF_JEQ, ETH_P_IPV6);
  program.Jump(BPF_JEQ, ETH_P_8021Q, 1, 0);
  program.Jump(BPF_JEQ, ETH_P_8021AD, 0, kToNo);
  program.Load(BPF_H, 2);  // the type behind the tag
  const size_t tagged_v4 = program.JumpAhead(BPF_JEQ, ETH_P_IP);
  program.Jump(BPF_JEQ, ETH_P_IPV6, 0, kToNo);
  V6(program, kVlanBytes, some);
  program.Land(tagged_v4);
  V4(program, kVlanBytes, some);
  program.Land(v4);
  V4(program, 0, some);
  program.Land(v6);
  V6(program, 0, some);
  return std::move(program).Finish();
}

bool ParseIp(uint16_t ethertype, absl::string_view packet, UdpDatagram& datagram) {
  if (ethertype == ETH_P_8021Q || ethertype == ETH_P_8021AD) {
    if (packet.size() < kVlanBytes) return false;
    ethertype = U16(packet, 2);
    packet.remove_prefix(kVlanBytes);
  }
  if (ethertype == ETH_P_IP) return ParseV4(packet, datagram);
  if (ethertype == ETH_P_IPV6) return ParseV6(packet, datagram);
  return false;
}

}  // namespace rips::wire
