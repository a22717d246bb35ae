#include "sensor_agent/wire/tap.h"

#include <poll.h>

#include <algorithm>
#include <cerrno>
#include <random>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "sensor_agent/wire/privileges.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::wire {

namespace {

// On a busy bus datagrams are taken this often instead of one by one. What comes in between waits
// in the receive buffer.
constexpr absl::Duration kBusyInterval = absl::Milliseconds(2);
// This often drops are logged.
constexpr int64_t kLookIntervalNs = 5 * kNanosPerSecond;
// This often the addresses of the host are read: the sensor looks as often, and must know a new one
// before the grace of what is sent from it is over.
constexpr int64_t kAddressesIntervalNs = kNanosPerSecond;
constexpr uint32_t kDomainMax = 232;

SipKey RandomSipKey() {
  std::random_device random;
  const auto word = [&random] { return uint64_t{random()} << 32 | random(); };
  SipKey key;
  key.low = word();
  key.high = word();
  return key;
}

}  // namespace

Tap::Tap(TapOptions options, const Clock* clock)
    : options_(std::move(options)),
      clock_(clock),
      table_(RandomSipKey()),
      sender_(options_.socket) {}

absl::StatusOr<std::unique_ptr<Tap>> Tap::Create(TapOptions options, const Clock* clock) {
  if (options.domain > kDomainMax) {
    return absl::InvalidArgumentError(
        absl::StrCat("domain ", options.domain, " exceeds limit ", kDomainMax));
  }
  if (options.interfaces.size() > kInterfacesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat(options.interfaces.size(), " interfaces exceed limit ", kInterfacesMax));
  }
  std::unique_ptr<Tap> tap(new Tap(std::move(options), clock));
  const std::vector<PortRange> ranges = {PortsOfDomain(tap->options_.domain), EphemeralPorts()};
  std::vector<std::string> interfaces = tap->options_.interfaces;
  if (interfaces.empty()) interfaces = {""};
  for (const std::string& interface : interfaces) {
    RIPS_ASSIGN_OR_RETURN(auto socket, PacketSocket::Open(interface, ranges));
    LogInfo("listening", {{"interface", interface.empty() ? "all" : interface},
                          {"receive_buffer_bytes", socket->receive_buffer_bytes()}});
    tap->sockets_.push_back(std::move(socket));
  }
  RIPS_RETURN_IF_ERROR(DropPrivileges());
  return tap;
}

absl::Status Tap::Run(int stop_fd, const std::function<void()>& on_turn) {
  std::vector<pollfd> fds = {{.fd = stop_fd, .events = POLLIN, .revents = 0}};
  for (const auto& socket : sockets_) {
    fds.push_back({.fd = socket->fd(), .events = POLLIN, .revents = 0});
  }
  int64_t next_report_ns = clock_->Now().boottime_ns;
  for (;;) {
    const int64_t now_ns = clock_->Now().boottime_ns;
    if (now_ns >= next_report_ns) {
      for (const auto& socket : sockets_) RIPS_RETURN_IF_ERROR(socket->CheckInterface());
      Report(now_ns);
      next_report_ns = now_ns + kReportIntervalNs;
      if (on_turn) on_turn();
    }
    const int64_t wait_ms = (next_report_ns - now_ns + kNanosPerMilli - 1) / kNanosPerMilli;
    if (poll(fds.data(), fds.size(), static_cast<int>(wait_ms)) < 0 && errno != EINTR) {
      return absl::ErrnoToStatus(errno, "waiting for packets");
    }
    if (fds.front().revents != 0) return absl::OkStatus();
    const bool some = std::any_of(fds.begin() + 1, fds.end(),
                                  [](const pollfd& each) { return each.revents != 0; });
    if (!some) continue;
    RIPS_RETURN_IF_ERROR(Drain(clock_->Now().boottime_ns));
    absl::SleepFor(kBusyInterval);
  }
}

absl::Status Tap::Drain(int64_t now_ns) {
  for (const auto& socket : sockets_) {
    // Bounded, so that a flood does not keep the reports back.
    constexpr int kReadsAtOnce = 64;
    for (int i = 0; i < kReadsAtOnce; ++i) {
      RIPS_ASSIGN_OR_RETURN(const size_t count, socket->Read([&](const UdpDatagram& udp) {
        if (!ParseRtps(udp.bytes, udp.size, datagram_)) return;
        table_.Add(datagram_, udp.source, udp.to, now_ns);
      }));
      if (count < PacketSocket::kReadMax) break;
    }
  }
  return absl::OkStatus();
}

void Tap::Report(int64_t now_ns) {
  for (const auto& socket : sockets_) table_.AddKernelDrops(socket->TakeDrops());
  if (now_ns >= next_addresses_ns_) {
    next_addresses_ns_ = now_ns + kAddressesIntervalNs;
    local_addresses_ = LocalAddresses();
  }
  if (now_ns >= next_look_ns_) {
    next_look_ns_ = now_ns + kLookIntervalNs;
    const uint64_t drops = table_.counters().kernel_drops + table_.counters().table_drops;
    if (drops > drops_logged_) {
      LogWarning("datagrams not inspected", {{"kernel_drops", table_.counters().kernel_drops},
                                             {"table_drops", table_.counters().table_drops}});
    }
    drops_logged_ = drops;
  }
  const bool ready = sender_.Ready(now_ns);
  if (sender_.connected() != was_connected_) {
    was_connected_ = sender_.connected();
    if (was_connected_) {
      LogInfo("sensor connected", {{"socket", options_.socket}});
      // Who has left before the sensor came is nobody it could have discovered.
      table_.Take();
    } else {
      LogWarning("sensor disconnected", {{"error", sender_.status().message()}});
    }
  }
  if (!ready) return;
  TapReport report{.domain = options_.domain,
                   .boottime_ns = now_ns,
                   .counters = table_.counters(),
                   .local_addresses = local_addresses_,
                   .traffic = table_.Take()};
  sender_.Send(report, now_ns);
}

}  // namespace rips::wire
