// Who can be isolated: hosts by address, DDS participants by GUID prefix; and who never can.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_TARGET_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_TARGET_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::actuator {

inline constexpr size_t kTargetsMax = 64;  // of one step

enum class TargetKind { kIpv4, kIpv6, kMac, kParticipant };

struct Target {
  TargetKind kind = TargetKind::kIpv4;
  // As nft prints it: `10.0.0.7`, `fd00::7`, `02:00:5e:00:53:01`, 24 hexadecimal digits; small.
  std::string text;
  friend bool operator==(const Target&, const Target&) = default;
};

// A numeric IPv4 or IPv6 address (no zone, no prefix length), or a MAC address with colons.
// InvalidArgument otherwise, and for addresses that are no single host's: unspecified, loopback,
// multicast, broadcast, IPv4 written as IPv6.
absl::StatusOr<Target> ParseHostTarget(absl::string_view text);

// 24 hexadecimal digits, not all zero: the first 12 bytes of the GUIDs of one participant
// (DDSI-RTPS 2.5 §9.3.1.5), in wire order.
absl::StatusOr<Target> ParseParticipantTarget(absl::string_view text);

// A policy server as the firewall knows it.
struct ControlAddress {
  TargetKind kind = TargetKind::kIpv4;  // kIpv4 or kIpv6
  std::string address;                  // as Target::text
  uint16_t port = 0;
  friend auto operator<=>(const ControlAddress&, const ControlAddress&) = default;
};

// What no isolation may cut, as addresses in the form of Target::text.
struct KeptOpen {
  std::vector<std::string> servers;
  std::vector<std::string> own;       // IP and MAC addresses of this host
  std::vector<std::string> gateways;  // next hops of its default routes
};

// InvalidArgument, saying what it is, if `target` is one of them.
absl::Status CheckMayBeIsolated(const Target& target, const KeptOpen& kept);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_TARGET_H_
