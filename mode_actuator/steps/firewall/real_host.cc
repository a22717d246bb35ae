#include "mode_actuator/steps/firewall/real_host.h"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netpacket/packet.h>
#include <sys/socket.h>

#include <cstdint>
#include <fstream>
#include <optional>
#include <sstream>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_split.h"
#include "mode_actuator/steps/firewall/nft_script.h"
#include "services/base/status_macros.h"
#include "services/runtime/real_clock.h"

namespace rips::actuator {
namespace {

constexpr size_t kMacBytes = 6;

struct HostPort {
  std::string host;
  uint16_t port = 0;
};

std::optional<HostPort> Split(absl::string_view server) {
  const size_t colon = server.rfind(':');
  uint32_t port = 0;
  if (colon == absl::string_view::npos || !absl::SimpleAtoi(server.substr(colon + 1), &port) ||
      port > 65535) {
    return std::nullopt;
  }
  absl::string_view host = server.substr(0, colon);
  if (host.size() > 2 && host.front() == '[' && host.back() == ']') {
    host = host.substr(1, host.size() - 2);
  }
  return HostPort{std::string(host), static_cast<uint16_t>(port)};
}

// As nft prints it; nullopt for other families.
std::optional<Target> AddressOf(const sockaddr* address) {
  char text[INET6_ADDRSTRLEN];
  if (address->sa_family == AF_INET) {
    const auto* v4 = reinterpret_cast<const sockaddr_in*>(address);
    inet_ntop(AF_INET, &v4->sin_addr, text, sizeof(text));
    return Target{TargetKind::kIpv4, text};
  }
  if (address->sa_family == AF_INET6) {
    const auto* v6 = reinterpret_cast<const sockaddr_in6*>(address);
    inet_ntop(AF_INET6, &v6->sin6_addr, text, sizeof(text));
    return Target{TargetKind::kIpv6, text};
  }
  if (address->sa_family == AF_PACKET) {
    const auto* link = reinterpret_cast<const sockaddr_ll*>(address);
    if (link->sll_halen != kMacBytes) return std::nullopt;
    std::string mac;
    for (size_t i = 0; i < kMacBytes; ++i) {
      absl::StrAppendFormat(&mac, "%s%02x", i == 0 ? "" : ":", link->sll_addr[i]);
    }
    return Target{TargetKind::kMac, mac};
  }
  return std::nullopt;
}

std::string ReadProc(const char* path) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

}  // namespace

absl::StatusOr<ControlAddress> ParseNumericServer(absl::string_view server) {
  const std::optional<HostPort> split = Split(server);
  if (!split.has_value()) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", absl::CHexEscape(server.substr(0, 100)), "` is not HOST:PORT"));
  }
  char text[INET6_ADDRSTRLEN];
  in_addr v4;
  if (inet_pton(AF_INET, split->host.c_str(), &v4) == 1) {
    inet_ntop(AF_INET, &v4, text, sizeof(text));
    return ControlAddress{TargetKind::kIpv4, text, split->port};
  }
  in6_addr v6;
  if (inet_pton(AF_INET6, split->host.c_str(), &v6) == 1) {
    inet_ntop(AF_INET6, &v6, text, sizeof(text));
    return ControlAddress{TargetKind::kIpv6, text, split->port};
  }
  return absl::NotFoundError("a name");
}

std::vector<std::string> DefaultGateways(absl::string_view route, absl::string_view ipv6_route) {
  std::vector<std::string> gateways;
  char text[INET6_ADDRSTRLEN];
  for (const absl::string_view line : absl::StrSplit(route, '\n')) {
    const std::vector<absl::string_view> fields =
        absl::StrSplit(line, absl::ByAnyChar(" \t"), absl::SkipEmpty());
    uint32_t gateway = 0;
    if (fields.size() < 8 || fields[1] != "00000000" || fields[7] != "00000000" ||
        !absl::SimpleHexAtoi(fields[2], &gateway) || gateway == 0) {
      continue;
    }
    const in_addr address = {gateway};  // printed by the kernel as it lies in memory
    inet_ntop(AF_INET, &address, text, sizeof(text));
    gateways.emplace_back(text);
  }
  for (const absl::string_view line : absl::StrSplit(ipv6_route, '\n')) {
    const std::vector<absl::string_view> fields =
        absl::StrSplit(line, absl::ByAnyChar(" \t"), absl::SkipEmpty());
    if (fields.size() < 5 || fields[1] != "00" || fields[4].size() != 32 ||
        fields[4].find_first_not_of("0123456789abcdef") != absl::string_view::npos ||
        fields[4].find_first_not_of('0') == absl::string_view::npos) {
      continue;
    }
    const std::string bytes = absl::HexStringToBytes(fields[4]);
    inet_ntop(AF_INET6, bytes.data(), text, sizeof(text));
    gateways.emplace_back(text);
  }
  return gateways;
}

RealHost::RealHost(std::vector<std::string> servers) : servers_(std::move(servers)) {
  bool names = false;
  {
    MutexLock lock(&mu_);
    for (const std::string& server : servers_) {
      const absl::StatusOr<ControlAddress> numeric = ParseNumericServer(server);
      if (numeric.ok()) {
        known_.insert(*numeric);
      } else {
        missing_[server] = "not looked up yet";
        names = true;
      }
    }
  }
  if (!names) return;
  ticker_.emplace(absl::ZeroDuration(), [this] {
    for (const std::string& server : servers_) {
      if (absl::IsNotFound(ParseNumericServer(server).status())) Resolve(server);
    }
    return kResolveEvery;
  });
}

void RealHost::Resolve(const std::string& server) {
  const HostPort split = Split(server).value_or(HostPort{});
  addrinfo hints = {};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  const int error = getaddrinfo(split.host.c_str(), nullptr, &hints, &found);
  MutexLock lock(&mu_);
  if (error != 0) {
    if (missing_.contains(server)) missing_[server] = gai_strerror(error);
    return;
  }
  for (const addrinfo* each = found; each != nullptr; each = each->ai_next) {
    const std::optional<Target> target = AddressOf(each->ai_addr);
    if (!target.has_value() || known_.size() >= kControlMax) continue;
    known_.insert({target->kind, target->text, split.port});
    missing_.erase(server);
  }
  freeaddrinfo(found);
}

absl::StatusOr<std::vector<ControlAddress>> RealHost::Control() {
  MutexLock lock(&mu_);
  if (!missing_.empty()) {
    const auto& [server, why] = *missing_.begin();
    return absl::UnavailableError(
        absl::StrCat("the address of server `", server, "` is not known: ", why));
  }
  return std::vector<ControlAddress>(known_.begin(), known_.end());
}

absl::StatusOr<KeptOpen> RealHost::Kept() {
  RIPS_ASSIGN_OR_RETURN(const std::vector<ControlAddress> control, Control());
  KeptOpen kept;
  for (const ControlAddress& server : control) kept.servers.push_back(server.address);
  ifaddrs* interfaces = nullptr;
  if (getifaddrs(&interfaces) != 0) {
    return absl::UnavailableError("cannot list the addresses of this host");
  }
  for (const ifaddrs* each = interfaces; each != nullptr; each = each->ifa_next) {
    if (each->ifa_addr == nullptr) continue;
    if (std::optional<Target> own = AddressOf(each->ifa_addr)) kept.own.push_back(own->text);
  }
  freeifaddrs(interfaces);
  kept.gateways = DefaultGateways(ReadProc("/proc/net/route"), ReadProc("/proc/net/ipv6_route"));
  return kept;
}

}  // namespace rips::actuator
