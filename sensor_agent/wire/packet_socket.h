// Reads the RTPS datagrams of this host's interfaces without taking part (packet(7)). Opening needs
// CAP_NET_RAW, reading nothing.
#ifndef RIPS_SENSOR_AGENT_WIRE_PACKET_SOCKET_H_
#define RIPS_SENSOR_AGENT_WIRE_PACKET_SOCKET_H_

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "sensor_agent/wire/packet_filter.h"
#include "services/runtime/unique_fd.h"

namespace rips::wire {

// Bytes of a packet that are captured, from behind the link header. A datagram's submessages
// beyond are not seen, and RtpsDatagram::cut says so.
inline constexpr size_t kSnapBytes = 1'600;
// Asked of the kernel; without CAP_NET_ADMIN it grants no more than net.core.rmem_max.
inline constexpr int kReceiveBufferBytes = 16 << 20;

// One thread.
class PacketSocket {
 public:
  // `interface` empty = all, those that come later too. NotFound if there is none of that name;
  // PermissionDenied without CAP_NET_RAW.
  static absl::StatusOr<std::unique_ptr<PacketSocket>> Open(const std::string& interface,
                                                            const std::vector<PortRange>& ranges);
  ~PacketSocket();
  PacketSocket(const PacketSocket&) = delete;
  PacketSocket& operator=(const PacketSocket&) = delete;

  // For poll.
  int fd() const { return fd_.get(); }
  // Hands on what is there, at most kReadMax. How many packets were read, whatever they held. OK
  // while the interface is down. The system's error otherwise.
  static constexpr size_t kReadMax = 64;
  using Use = std::function<void(const UdpDatagram&)>;
  absl::StatusOr<size_t> Read(const Use& use);
  // Unavailable once the interface is gone; nothing comes any more then, even if another of its
  // name appears.
  absl::Status CheckInterface() const;
  // Packets the kernel had no room for, since the last call.
  uint64_t TakeDrops();
  // Bytes granted.
  int receive_buffer_bytes() const;
  const std::string& interface() const { return interface_; }

 private:
  struct Buffers;
  PacketSocket(std::string interface, int index, UniqueFd fd);

  const std::string interface_;
  const int index_;  // 0 = all
  UniqueFd fd_;
  std::unique_ptr<Buffers> buffers_;
};

// Ports that systems give to sockets that ask for none: Cyclone DDS receives on such a port unless
// a participant index is configured. From the first one that this host gives
// (net.ipv4.ip_local_port_range; 32768 if it cannot be read) to 65535, which others may give.
PortRange EphemeralPorts();

// Addresses of this host's interfaces now, sorted.
std::vector<Address> LocalAddresses();

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_PACKET_SOCKET_H_
