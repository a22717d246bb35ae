// RTPS datagrams under another participant's name, from an ordinary socket, to all that listen in
// the tests' domain on the loopback interface (DDSI-RTPS 2.5 §9.4). Test code only.
#ifndef RIPS_TESTS_SUPPORT_ROS2_FORGED_RTPS_H_
#define RIPS_TESTS_SUPPORT_ROS2_FORGED_RTPS_H_

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdint>
#include <string>

#include "absl/strings/string_view.h"
#include "services/ros2/guid.h"
#include "tests/support/ros2/test_world.h"

namespace rips::dds {

// Little-endian.
inline std::string Bytes32(uint32_t value) {
  std::string bytes(4, '\0');
  for (int i = 0; i < 4; ++i) bytes[i] = static_cast<char>(value >> (8 * i));
  return bytes;
}

// A SequenceNumber_t: the high word comes first.
inline std::string NumberBytes(uint64_t number) {
  return Bytes32(static_cast<uint32_t>(number >> 32)) + Bytes32(static_cast<uint32_t>(number));
}

inline std::string Submessage(uint8_t kind, uint8_t flags, const std::string& body) {
  return std::string({static_cast<char>(kind), static_cast<char>(flags | 1)}) +
         Bytes32(static_cast<uint32_t>(body.size())).substr(0, 2) + body;
}

inline std::string Header(const ros2::Guid& writer) {
  return "RTPS" + std::string("\x02\x01\x01\x10", 4) + writer.ToBytes().substr(0, 12);
}

inline std::string EntityId(const ros2::Guid& guid) { return guid.ToBytes().substr(12); }

// `payload` has its encapsulation header. The source time is 2001.
inline std::string ForgedData(const ros2::Guid& writer, uint64_t number,
                              const std::string& payload) {
  return Header(writer) + Submessage(0x09, 0, Bytes32(1'000'000'000) + Bytes32(0)) +
         Submessage(0x15, 0x04,
                    std::string("\0\0\x10\0\0\0\0\0", 8) + EntityId(writer) + NumberBytes(number) +
                        payload);
}

inline std::string ForgedHeartbeat(const ros2::Guid& writer, uint64_t first, uint64_t last) {
  return Header(writer) + Submessage(0x07, 0,
                                     std::string(4, '\0') + EntityId(writer) + NumberBytes(first) +
                                         NumberBytes(last) + Bytes32(1'000));
}

// To `reader`: nothing from `first` to before `end` will come.
inline std::string ForgedGap(const ros2::Guid& writer, const ros2::Guid& reader, uint64_t first,
                             uint64_t end) {
  return Header(writer) + Submessage(0x0e, 0, reader.ToBytes().substr(0, 12)) +
         Submessage(0x08, 0,
                    EntityId(reader) + EntityId(writer) + NumberBytes(first) + NumberBytes(end) +
                        Bytes32(1) + Bytes32(0));
}

// To the multicast ports of `domain`: that of data, or, for writers of discovery, that of metadata
// (DDSI-RTPS 2.5 §9.6.2.3).
inline void SendForged(const std::string& datagram, bool discovery = false,
                       uint32_t domain = RandomDomain()) {
  const int fd = socket(AF_INET, SOCK_DGRAM, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_port = htons(static_cast<uint16_t>(7400 + 250 * domain + (discovery ? 0 : 1)));
  inet_pton(AF_INET, "239.255.0.1", &to.sin_addr);
  in_addr loopback{.s_addr = htonl(INADDR_LOOPBACK)};
  EXPECT_EQ(setsockopt(fd, IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof(loopback)), 0);
  EXPECT_EQ(
      sendto(fd, datagram.data(), datagram.size(), 0, reinterpret_cast<sockaddr*>(&to), sizeof(to)),
      static_cast<ssize_t>(datagram.size()));
  close(fd);
}

}  // namespace rips::dds

#endif  // RIPS_TESTS_SUPPORT_ROS2_FORGED_RTPS_H_
