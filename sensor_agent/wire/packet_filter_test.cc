#include "sensor_agent/wire/packet_filter.h"

#include <linux/if_arp.h>
#include <linux/if_ether.h>
#include <linux/if_packet.h>

#include <optional>
#include <string>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"

namespace rips::wire {
namespace {

struct Packet {
  uint16_t ethertype = ETH_P_IP;
  std::string bytes;
  uint8_t direction = PACKET_HOST;
  uint16_t hardware = ARPHRD_ETHER;
};

uint32_t Number(absl::string_view bytes, size_t at, size_t count) {
  uint32_t value = 0;
  for (size_t i = 0; i < count; ++i) value = value * 256 + static_cast<uint8_t>(bytes[at + i]);
  return value;
}

// What a load gives; nullopt past the end, where the kernel drops the packet.
std::optional<uint32_t> Load(const Packet& packet, uint16_t size, uint32_t at) {
  switch (static_cast<int>(at) - SKF_AD_OFF) {
    case SKF_AD_PROTOCOL:
      return packet.ethertype;
    case SKF_AD_PKTTYPE:
      return packet.direction;
    case SKF_AD_HATYPE:
      return packet.hardware;
    default:
      break;
  }
  const size_t count = size == BPF_W ? 4 : size == BPF_H ? 2 : 1;
  if (uint64_t{at} + count > packet.bytes.size()) return std::nullopt;
  return Number(packet.bytes, at, count);
}

// The filter machine of the kernel (bpf(4)), as far as RtpsFilter uses it.
bool Passes(const std::vector<sock_filter>& program, const Packet& packet) {
  uint32_t a = 0;
  uint32_t x = 0;
  for (size_t pc = 0; pc < program.size(); ++pc) {
    const sock_filter& each = program[pc];
    std::optional<uint32_t> loaded;
    switch (each.code & ~BPF_SIZE(0xff)) {
      case BPF_LD | BPF_ABS:
      case BPF_LD | BPF_IND:
        loaded =
            Load(packet, BPF_SIZE(each.code), BPF_MODE(each.code) == BPF_IND ? each.k + x : each.k);
        if (!loaded.has_value()) return false;
        a = *loaded;
        continue;
      case BPF_LDX | BPF_IMM:
        x = each.k;
        continue;
      case BPF_LDX | BPF_MSH:
        loaded = Load(packet, BPF_B, each.k);
        if (!loaded.has_value()) return false;
        x = 4 * (*loaded & 0xf);
        continue;
      case BPF_RET | BPF_K:
        return each.k != 0;
      default:
        break;
    }
    bool yes = false;
    switch (each.code) {
      case BPF_JMP | BPF_JEQ | BPF_K:
        yes = a == each.k;
        break;
      case BPF_JMP | BPF_JGE | BPF_K:
        yes = a >= each.k;
        break;
      case BPF_JMP | BPF_JGT | BPF_K:
        yes = a > each.k;
        break;
      case BPF_JMP | BPF_JSET | BPF_K:
        yes = (a & each.k) != 0;
        break;
      default:
        ADD_FAILURE() << "instruction " << pc << " is not known: " << each.code;
        return false;
    }
    pc += yes ? each.jt : each.jf;
  }
  ADD_FAILURE() << "the program runs past its end";
  return false;
}

std::string U16(uint32_t value) {
  return {static_cast<char>(value >> 8), static_cast<char>(value)};
}

std::string Udp(uint16_t port, const std::string& payload = "RTPSpayload") {
  return U16(1234) + U16(port) + U16(static_cast<uint32_t>(8 + payload.size())) + U16(0) + payload;
}

std::string V4(const std::string& payload, uint8_t protocol = 17, uint16_t fragment = 0,
               size_t options = 0) {
  std::string header(20 + options, '\0');
  header[0] = static_cast<char>(0x40 + header.size() / 4);
  header.replace(6, 2, U16(fragment));
  header[9] = static_cast<char>(protocol);
  header.replace(12, 8, std::string("\x0a\0\0\1\x0a\0\0\2", 8));
  return header + payload;
}

std::string V6(uint8_t next, const std::string& payload) {
  std::string header(40, '\0');
  header[0] = 0x60;
  header[6] = static_cast<char>(next);
  header[23] = 1;
  header[39] = 2;
  return header + payload;
}

std::string V6Fragment(uint16_t offset, const std::string& payload) {
  return V6(44, std::string("\x11\0", 2) + U16(offset) + "ident" + payload).substr(0, 48) + payload;
}

std::string Tag(uint16_t type) { return U16(5) + U16(type); }

struct Case {
  std::string name;
  bool passes = true;
  // What ParseIp finds of those that pass; the port.
  bool parses = true;
  Packet packet;
};

std::vector<Case> Cases() {
  const std::string options = std::string("\x11\x01", 2) + std::string(14, '\0');
  return {
      {"IPv4", true, true, {ETH_P_IP, V4(Udp(9'900))}},
      {"the domain's last port", true, true, {ETH_P_IP, V4(Udp(10'149))}},
      {"a port the kernel gave", true, true, {ETH_P_IP, V4(Udp(32'768))}},
      {"the last such port", true, true, {ETH_P_IP, V4(Udp(60'999))}},
      {"IP options", true, true, {ETH_P_IP, V4(Udp(9'900), 17, 0, 40)}},
      {"first fragment", true, true, {ETH_P_IP, V4(Udp(9'900), 17, 0x2000)}},
      {"encrypted", true, true, {ETH_P_IP, V4(Udp(9'900, "RTPX"))}},
      {"IPv6", true, true, {ETH_P_IPV6, V6(17, Udp(9'900))}},
      {"IPv6 first fragment", true, true, {ETH_P_IPV6, V6Fragment(1, Udp(9'900))}},
      {"IPv6 options", true, true, {ETH_P_IPV6, V6(60, options + Udp(9'900))}},
      {"IPv6 hop by hop", true, true, {ETH_P_IPV6, V6(0, options + Udp(9'900))}},
      {"IPv6 routing", true, true, {ETH_P_IPV6, V6(43, options + Udp(9'900))}},
      {"IPv6 options cut", true, false, {ETH_P_IPV6, V6(60, options.substr(0, 15))}},
      {"IPv6 endless options",
       true,
       false,
       {ETH_P_IPV6, V6(60, std::string(20 * 8, '\x3c').replace(1, 1, 1, '\0'))}},
      {"tagged", true, true, {ETH_P_8021Q, Tag(ETH_P_IP) + V4(Udp(9'900))}},
      {"tagged IPv6", true, true, {ETH_P_8021AD, Tag(ETH_P_IPV6) + V6(17, Udp(9'900))}},
      {"leaving", true, true, {ETH_P_IP, V4(Udp(9'900)), PACKET_OUTGOING}},
      {"coming in by loopback",
       true,
       true,
       {ETH_P_IP, V4(Udp(9'900)), PACKET_HOST, ARPHRD_LOOPBACK}},
      {"leaving by loopback",
       false,
       true,
       {ETH_P_IP, V4(Udp(9'900)), PACKET_OUTGOING, ARPHRD_LOOPBACK}},
      {"the port before", false, true, {ETH_P_IP, V4(Udp(9'899))}},
      {"the port after", false, true, {ETH_P_IP, V4(Udp(10'150))}},
      {"between the ranges", false, true, {ETH_P_IP, V4(Udp(32'767))}},
      {"past all ranges", false, true, {ETH_P_IP, V4(Udp(61'000))}},
      {"no RTPS", false, true, {ETH_P_IP, V4(Udp(9'900, "RTSP"))}},
      {"too short for RTPS", false, true, {ETH_P_IP, V4(Udp(9'900, "RTP"))}},
      {"TCP", false, false, {ETH_P_IP, V4(Udp(9'900), 6)}},
      {"later fragment", false, false, {ETH_P_IP, V4(Udp(9'900), 17, 0x0001)}},
      {"last fragment", false, false, {ETH_P_IP, V4(Udp(9'900), 17, 0x1fff)}},
      {"IPv6 TCP", false, false, {ETH_P_IPV6, V6(6, Udp(9'900))}},
      {"IPv6 later fragment", false, false, {ETH_P_IPV6, V6Fragment(8, Udp(9'900))}},
      {"ARP", false, false, {ETH_P_ARP, V4(Udp(9'900))}},
      {"tagged ARP", false, false, {ETH_P_8021Q, Tag(ETH_P_ARP) + V4(Udp(9'900))}},
      {"tagged other port", false, true, {ETH_P_8021Q, Tag(ETH_P_IP) + V4(Udp(9'899))}},
      {"nothing", false, false, {ETH_P_IP, ""}},
      {"header only", false, false, {ETH_P_IP, V4("")}},
  };
}

TEST(PacketFilterTest, PassesRtpsOfTheDomainAndNothingElse) {
  const std::vector<sock_filter> program =
      RtpsFilter({PortsOfDomain(10), {.first = 32'768, .last = 60'999}});
  for (const Case& each : Cases()) {
    EXPECT_EQ(Passes(program, each.packet), each.passes) << each.name;
    UdpDatagram datagram;
    EXPECT_EQ(ParseIp(each.packet.ethertype, each.packet.bytes, datagram), each.parses)
        << each.name;
  }
}

TEST(PacketFilterTest, CutAnywhereAPacketStillMakesSenseOrDoesNotPass) {
  const std::vector<sock_filter> program = RtpsFilter({PortsOfDomain(10)});
  for (const Case& each : Cases()) {
    for (size_t bytes = 0; bytes < each.packet.bytes.size(); ++bytes) {
      Packet cut = each.packet;
      cut.bytes.resize(bytes);
      Passes(program, cut);
      UdpDatagram datagram;
      if (!ParseIp(cut.ethertype, cut.bytes, datagram)) continue;
      EXPECT_LE(datagram.bytes.size(), datagram.size) << each.name << bytes;
    }
  }
}

TEST(PacketFilterTest, FindsAddressesPortsAndPayload) {
  UdpDatagram datagram;
  const std::string v4 = V4(Udp(9'900)) + "padding";
  ASSERT_TRUE(ParseIp(ETH_P_IP, v4, datagram));
  EXPECT_EQ(ToString(datagram.source), "10.0.0.1:1234");
  EXPECT_EQ(ToString(datagram.to), "10.0.0.2:9900");
  EXPECT_EQ(datagram.bytes, "RTPSpayload");
  EXPECT_EQ(datagram.size, 11);

  const std::string v6 = V6Fragment(1, Udp(9'900)).substr(0, 48 + 8 + 4);
  ASSERT_TRUE(ParseIp(ETH_P_IPV6, v6, datagram));
  EXPECT_EQ(ToString(datagram.source), "[::1]:1234");
  EXPECT_EQ(ToString(datagram.to), "[::2]:9900");
  EXPECT_EQ(datagram.bytes, "RTPS");
  EXPECT_EQ(datagram.size, 11);
}

TEST(PacketFilterTest, ADatagramShorterThanItsHeaderIsNone) {
  std::string packet = V4(Udp(9'900));
  packet.replace(24, 2, U16(7));
  UdpDatagram datagram;
  EXPECT_FALSE(ParseIp(ETH_P_IP, packet, datagram));
}

TEST(PacketFilterTest, DomainsHaveTheirPorts) {
  EXPECT_EQ(PortsOfDomain(0), (PortRange{.first = 7'400, .last = 7'649}));
  EXPECT_EQ(PortsOfDomain(232), (PortRange{.first = 65'400, .last = 65'535}));
  EXPECT_EQ(PortsOfDomain(233), PortRange());
}

TEST(PacketFilterTest, FitsTheLimitOfRanges) {
  const PortRange range = {.first = 1, .last = 2};
  EXPECT_LE(RtpsFilter({range, range, range, range}).size(), size_t{BPF_MAXINSNS});
  // Empty ones do not count, and none at all pass nothing.
  EXPECT_FALSE(Passes(RtpsFilter({PortRange(), PortRange(), PortRange(), PortRange(), PortRange()}),
                      {ETH_P_IP, V4(Udp(9'900))}));
}

TEST(PacketFilterDeathTest, RefusesMoreRanges) {
  const PortRange range = {.first = 1, .last = 2};
  EXPECT_DEATH(RtpsFilter({range, range, range, range, range}), "too many port ranges");
}

}  // namespace
}  // namespace rips::wire
