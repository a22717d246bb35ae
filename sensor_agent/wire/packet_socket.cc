#include "sensor_agent/wire/packet_socket.h"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <linux/if_ether.h>
#include <linux/if_packet.h>
#include <net/if.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <fstream>
#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/log.h"

namespace rips::wire {

namespace {

constexpr uint16_t kUsualFirstEphemeral = 32'768;

absl::Status Errno(absl::string_view doing) {
  return absl::ErrnoToStatus(errno, absl::StrCat(doing));
}

absl::StatusOr<int> IndexOf(const std::string& interface) {
  if (interface.empty()) return 0;
  const unsigned index = if_nametoindex(interface.c_str());
  if (index != 0) return static_cast<int>(index);
  return absl::NotFoundError(absl::StrCat("there is no network interface `",
                                          ros2::Printable(interface), "`; see `ip link`"));
}

}  // namespace

struct PacketSocket::Buffers {
  std::array<std::array<char, kSnapBytes>, kReadMax> bytes;
  std::array<sockaddr_ll, kReadMax> from;
  std::array<iovec, kReadMax> vectors;
  std::array<mmsghdr, kReadMax> messages;
};

PacketSocket::PacketSocket(std::string interface, int index, UniqueFd fd)
    : interface_(std::move(interface)),
      index_(index),
      fd_(std::move(fd)),
      buffers_(std::make_unique<Buffers>()) {}

PacketSocket::~PacketSocket() = default;

absl::StatusOr<std::unique_ptr<PacketSocket>> PacketSocket::Open(
    const std::string& interface, const std::vector<PortRange>& ranges) {
  RIPS_ASSIGN_OR_RETURN(const int index, IndexOf(interface));
  // Protocol 0: nothing comes before the filter stands.
  UniqueFd fd(socket(AF_PACKET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (fd.get() < 0) {
    if (errno == EPERM || errno == EACCES) {
      return absl::PermissionDeniedError(
          "opening a packet socket is not permitted; give the process CAP_NET_RAW");
    }
    return Errno("opening a packet socket");
  }
  std::vector<sock_filter> filter = RtpsFilter(ranges);
  const sock_fprog program = {.len = static_cast<unsigned short>(filter.size()),
                              .filter = filter.data()};
  if (setsockopt(fd.get(), SOL_SOCKET, SO_ATTACH_FILTER, &program, sizeof program) != 0) {
    return Errno("attaching the packet filter");
  }
  const int bytes = kReceiveBufferBytes;
  if (setsockopt(fd.get(), SOL_SOCKET, SO_RCVBUFFORCE, &bytes, sizeof bytes) != 0 &&
      setsockopt(fd.get(), SOL_SOCKET, SO_RCVBUF, &bytes, sizeof bytes) != 0) {
    return Errno("asking for a receive buffer");
  }
  sockaddr_ll address = {};
  address.sll_family = AF_PACKET;
  address.sll_protocol = htons(ETH_P_ALL);
  address.sll_ifindex = index;
  if (bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    return Errno(absl::StrCat("listening on interface `", ros2::Printable(interface), "`"));
  }
  return std::unique_ptr<PacketSocket>(new PacketSocket(interface, index, std::move(fd)));
}

absl::StatusOr<size_t> PacketSocket::Read(const Use& use) {
  Buffers& b = *buffers_;
  for (size_t i = 0; i < kReadMax; ++i) {
    b.vectors[i] = {.iov_base = b.bytes[i].data(), .iov_len = kSnapBytes};
    b.messages[i] = {};
    b.messages[i].msg_hdr.msg_name = &b.from[i];
    b.messages[i].msg_hdr.msg_namelen = sizeof b.from[i];
    b.messages[i].msg_hdr.msg_iov = &b.vectors[i];
    b.messages[i].msg_hdr.msg_iovlen = 1;
  }
  const int count = recvmmsg(fd_.get(), b.messages.data(), kReadMax, MSG_DONTWAIT, nullptr);
  if (count < 0) {
    if (errno == EAGAIN || errno == EINTR) return 0;
    if (errno == ENETDOWN) {  // it goes on by itself when the interface is up again
      LogWarning("interface is down", {{"interface", interface_}});
      return 0;
    }
    return Errno(absl::StrCat("reading packets of `", interface_, "`"));
  }
  for (int i = 0; i < count; ++i) {
    const size_t captured = std::min<size_t>(b.messages[i].msg_len, kSnapBytes);
    UdpDatagram datagram;
    if (ParseIp(ntohs(b.from[i].sll_protocol), {b.bytes[i].data(), captured}, datagram)) {
      use(datagram);
    }
  }
  return static_cast<size_t>(count);
}

absl::Status PacketSocket::CheckInterface() const {
  if (index_ == 0) return absl::OkStatus();
  const absl::StatusOr<int> index = IndexOf(interface_);
  if (index.ok() && *index == index_) return absl::OkStatus();
  return absl::UnavailableError(absl::StrCat("interface `", interface_, "` is gone"));
}

uint64_t PacketSocket::TakeDrops() {
  tpacket_stats stats = {};
  socklen_t length = sizeof stats;
  if (getsockopt(fd_.get(), SOL_PACKET, PACKET_STATISTICS, &stats, &length) != 0) return 0;
  return stats.tp_drops;
}

int PacketSocket::receive_buffer_bytes() const {
  int bytes = 0;
  socklen_t length = sizeof bytes;
  if (getsockopt(fd_.get(), SOL_SOCKET, SO_RCVBUF, &bytes, &length) != 0) return 0;
  return bytes / 2;  // socket(7): the kernel doubles what it is asked for
}

PortRange EphemeralPorts() {
  uint16_t first = 0;
  std::ifstream in("/proc/sys/net/ipv4/ip_local_port_range");
  if (!(in >> first)) first = kUsualFirstEphemeral;
  return {.first = first, .last = std::numeric_limits<uint16_t>::max()};
}

std::vector<Address> LocalAddresses() {
  std::vector<Address> addresses;
  ifaddrs* all = nullptr;
  if (getifaddrs(&all) != 0) return addresses;
  for (const ifaddrs* each = all; each != nullptr; each = each->ifa_next) {
    if (each->ifa_addr == nullptr) continue;
    if (each->ifa_addr->sa_family == AF_INET) {
      const auto* v4 = reinterpret_cast<const sockaddr_in*>(each->ifa_addr);
      addresses.push_back(FromV4(reinterpret_cast<const uint8_t*>(&v4->sin_addr)));
    } else if (each->ifa_addr->sa_family == AF_INET6) {
      const auto* v6 = reinterpret_cast<const sockaddr_in6*>(each->ifa_addr);
      addresses.push_back(FromV6(v6->sin6_addr.s6_addr));
    }
  }
  freeifaddrs(all);
  std::sort(addresses.begin(), addresses.end());
  addresses.erase(std::unique(addresses.begin(), addresses.end()), addresses.end());
  return addresses;
}

}  // namespace rips::wire
