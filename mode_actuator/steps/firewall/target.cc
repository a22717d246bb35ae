#include "mode_actuator/steps/firewall/target.h"

#include <arpa/inet.h>
#include <netinet/in.h>

#include <algorithm>
#include <array>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "services/text/quote.h"

namespace rips::actuator {
namespace {

constexpr size_t kMacLength = 17;     // 02:00:5e:00:53:01
constexpr size_t kPrefixDigits = 24;  // 12 bytes

absl::Status NoHost(absl::string_view text, absl::string_view what) {
  return absl::InvalidArgumentError(absl::StrCat(QuoteBytes(text), " is ", what,
                                                 "; an isolated host needs an address of its own"));
}

absl::StatusOr<Target> FromIpv4(absl::string_view text, const in_addr& address) {
  const uint32_t host = ntohl(address.s_addr);
  if (host == INADDR_ANY || (host >> 24) == 0) return NoHost(text, "unspecified");
  if ((host >> 24) == 127) return NoHost(text, "a loopback address");
  if (IN_MULTICAST(host)) return NoHost(text, "a multicast address");
  if (host == INADDR_BROADCAST) return NoHost(text, "the broadcast address");
  char printed[INET_ADDRSTRLEN];
  inet_ntop(AF_INET, &address, printed, sizeof(printed));
  return Target{TargetKind::kIpv4, printed};
}

absl::StatusOr<Target> FromIpv6(absl::string_view text, const in6_addr& address) {
  if (IN6_IS_ADDR_UNSPECIFIED(&address)) return NoHost(text, "unspecified");
  if (IN6_IS_ADDR_LOOPBACK(&address)) return NoHost(text, "a loopback address");
  if (IN6_IS_ADDR_MULTICAST(&address)) return NoHost(text, "a multicast address");
  if (IN6_IS_ADDR_V4MAPPED(&address) || IN6_IS_ADDR_V4COMPAT(&address)) {
    return NoHost(text, "an IPv4 address written as IPv6");
  }
  char printed[INET6_ADDRSTRLEN];
  inet_ntop(AF_INET6, &address, printed, sizeof(printed));
  return Target{TargetKind::kIpv6, printed};
}

bool IsMac(absl::string_view text) {
  if (text.size() != kMacLength) return false;
  for (size_t i = 0; i < text.size(); ++i) {
    if (i % 3 == 2 ? text[i] != ':' : !absl::ascii_isxdigit(text[i])) return false;
  }
  return true;
}

absl::StatusOr<Target> FromMac(absl::string_view text) {
  const std::string mac = absl::AsciiStrToLower(text);
  if (mac == "00:00:00:00:00:00") return NoHost(text, "unspecified");
  const std::string first = absl::HexStringToBytes(mac.substr(0, 2));
  if ((static_cast<uint8_t>(first[0]) & 1) != 0) return NoHost(text, "a multicast address");
  return Target{TargetKind::kMac, mac};
}

bool Contains(const std::vector<std::string>& list, const std::string& text) {
  return std::find(list.begin(), list.end(), text) != list.end();
}

}  // namespace

absl::StatusOr<Target> ParseHostTarget(absl::string_view text) {
  const std::string owned(text);
  in_addr v4;
  in6_addr v6;
  // A NUL inside would end what inet_pton sees.
  const bool whole = text.find('\0') == absl::string_view::npos;
  if (whole && inet_pton(AF_INET, owned.c_str(), &v4) == 1) return FromIpv4(text, v4);
  if (whole && inet_pton(AF_INET6, owned.c_str(), &v6) == 1) return FromIpv6(text, v6);
  if (IsMac(text)) return FromMac(text);
  return absl::InvalidArgumentError(
      absl::StrCat(QuoteBytes(text), " is no IPv4, IPv6 or MAC address; names are not looked up"));
}

absl::StatusOr<Target> ParseParticipantTarget(absl::string_view text) {
  const bool digits = std::all_of(text.begin(), text.end(),
                                  [](unsigned char c) { return absl::ascii_isxdigit(c); });
  if (text.size() != kPrefixDigits || !digits) {
    return absl::InvalidArgumentError(absl::StrCat(
        QuoteBytes(text), " is no GUID prefix; write its 12 bytes as 24 hexadecimal digits"));
  }
  if (text.find_first_not_of('0') == absl::string_view::npos) {
    return absl::InvalidArgumentError(absl::StrCat(QuoteBytes(text), " names no participant"));
  }
  return Target{TargetKind::kParticipant, absl::AsciiStrToLower(text)};
}

absl::Status CheckMayBeIsolated(const Target& target, const KeptOpen& kept) {
  absl::string_view what;
  if (Contains(kept.servers, target.text)) {
    what = "a policy server";
  } else if (Contains(kept.own, target.text)) {
    what = "this host itself";
  } else if (Contains(kept.gateways, target.text)) {
    what = "the gateway";
  } else {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(
      absl::StrCat(QuoteBytes(target.text), " is ", what, ", which is never isolated"));
}

}  // namespace rips::actuator
