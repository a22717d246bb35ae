// rips-wire: listens to the RTPS traffic of one DDS domain on this host and tells the sensor.
#ifndef RIPS_SENSOR_AGENT_WIRE_TAP_H_
#define RIPS_SENSOR_AGENT_WIRE_TAP_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "sensor_agent/wire/packet_socket.h"
#include "sensor_agent/wire/report_sender.h"
#include "sensor_agent/wire/traffic.h"
#include "services/base/clock.h"

namespace rips::wire {

struct TapOptions {
  uint32_t domain = 0;
  // Names; empty = all there are and will be.
  std::vector<std::string> interfaces;
  std::string socket = "/run/rips/wire.sock";
};

inline constexpr size_t kInterfacesMax = 16;
inline constexpr int64_t kReportIntervalNs = 200 * kNanosPerMilli;

class Tap {
 public:
  // Opens the packet sockets, then gives up all privileges of the calling thread. InvalidArgument
  // for a domain above 232 or more than kInterfacesMax interfaces; the errors of
  // PacketSocket::Open. `clock` is not owned and outlives this.
  static absl::StatusOr<std::unique_ptr<Tap>> Create(TapOptions options, const Clock* clock);

  // Tells the sensor what came since it has been connected, until `stop_fd` becomes readable. Calls
  // `on_turn`, which may be null, at least once a second while it does not hang.
  // Unavailable when an interface is gone: privileges to open another are gone, too.
  absl::Status Run(int stop_fd, const std::function<void()>& on_turn = nullptr);

 private:
  Tap(TapOptions options, const Clock* clock);

  absl::Status Drain(int64_t now_ns);
  void Report(int64_t now_ns);

  const TapOptions options_;
  const Clock* clock_;
  std::vector<std::unique_ptr<PacketSocket>> sockets_;
  TrafficTable table_;
  RtpsDatagram datagram_;
  ReportSender sender_;
  std::vector<Address> local_addresses_;
  int64_t next_look_ns_ = 0;
  int64_t next_addresses_ns_ = 0;
  bool was_connected_ = false;
  uint64_t drops_logged_ = 0;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_TAP_H_
