#include "services/rpc/connection_admission.h"

#include <arpa/inet.h>
#include <netinet/in.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>
#include <vector>

#include "absl/strings/str_cat.h"

namespace rips::rpc {
namespace {

std::string Text(int family, const void* address) {
  std::array<char, INET6_ADDRSTRLEN> text = {};
  return inet_ntop(family, address, text.data(), text.size()) == nullptr ? "" : text.data();
}

// The first `bytes` of the address, the rest zero.
std::string Prefix(const in6_addr& address, size_t bytes) {
  in6_addr prefix = {};
  std::memcpy(prefix.s6_addr, address.s6_addr, bytes);
  return absl::StrCat(Text(AF_INET6, &prefix), "/", bytes * 8);
}

Source OfV4(const in_addr& address, uint16_t port) {
  const std::string text = Text(AF_INET, &address);
  return {.peer = absl::StrCat("ipv4:", text, ":", port),
          .address = text,
          .network = absl::StrCat(text.substr(0, text.rfind('.')), ".0/24")};
}

}  // namespace

Source SourceOf(const sockaddr_storage& address) {
  if (address.ss_family == AF_INET) {
    sockaddr_in v4 = {};
    std::memcpy(&v4, &address, sizeof(v4));
    return OfV4(v4.sin_addr, ntohs(v4.sin_port));
  }
  if (address.ss_family != AF_INET6) return {};
  sockaddr_in6 v6 = {};
  std::memcpy(&v6, &address, sizeof(v6));
  const uint16_t port = ntohs(v6.sin6_port);
  if (IN6_IS_ADDR_V4MAPPED(&v6.sin6_addr)) {
    in_addr v4 = {};
    std::memcpy(&v4, v6.sin6_addr.s6_addr + 12, sizeof(v4));
    return OfV4(v4, port);
  }
  return {.peer = absl::StrCat("ipv6:[", Text(AF_INET6, &v6.sin6_addr), "]:", port),
          .address = Prefix(v6.sin6_addr, 8),
          .network = Prefix(v6.sin6_addr, 6)};
}

Admission::Address& Admission::Touch(const std::string& address, int64_t now_ns) {
  const auto [it, fresh] = addresses_.try_emplace(address);
  Address& entry = it->second;
  if (fresh) {
    entry.tokens = limits_.burst;
  } else {
    const double seconds = static_cast<double>(now_ns - entry.touched_ns) / kNanosPerSecond;
    // An address that broke the limits is admitted slowly if it may be of an agent.
    const bool slow = now_ns < entry.banned_until_ns;
    entry.tokens = std::min(slow ? 1.0 : limits_.burst,
                            entry.tokens + seconds * (slow ? 1.0 : limits_.per_second));
  }
  entry.touched_ns = now_ns;
  return entry;
}

void Admission::Forget() {
  if (addresses_.size() <= kAddressesMax) return;
  // Half of them at once, so that the next thousands cost nothing.
  std::vector<int64_t> touched;
  for (const auto& [name, address] : addresses_) {
    if (address.connections == 0) touched.push_back(address.touched_ns);
  }
  if (touched.empty()) return;
  const auto middle = touched.begin() + static_cast<std::ptrdiff_t>(touched.size() / 2);
  std::nth_element(touched.begin(), middle, touched.end());
  absl::erase_if(addresses_, [&](const auto& entry) {
    return entry.second.connections == 0 && entry.second.touched_ns <= *middle;
  });
}

Admission::Verdict Admission::Ask(const Source& source, int64_t now_ns) {
  Forget();
  Address& address = Touch(source.address, now_ns);
  const bool known = now_ns < address.known_until_ns;
  if (!known && now_ns < address.banned_until_ns) return Verdict::kBanned;
  if (address.tokens < 1) return Verdict::kRate;
  if (address.connections >= limits_.per_address) return Verdict::kAddress;
  const auto network = networks_.find(source.network);
  if (network != networks_.end() && network->second >= limits_.per_network) {
    return Verdict::kNetwork;
  }
  const int open_to_it = known ? limits_.total : limits_.total - limits_.reserve;
  if (total_ >= open_to_it) return Verdict::kTotal;
  address.tokens -= 1;
  ++address.connections;
  ++networks_[source.network];
  ++total_;
  return Verdict::kTake;
}

void Admission::Left(const Source& source) {
  --total_;
  if (const auto it = addresses_.find(source.address); it != addresses_.end()) {
    --it->second.connections;
  }
  const auto network = networks_.find(source.network);
  if (network != networks_.end() && --network->second == 0) networks_.erase(network);
}

bool Admission::MayVouch(const std::string& address, const std::string& certificate,
                         int64_t now_ns) {
  const auto over = [now_ns](const auto& each) { return each.second <= now_ns; };
  if (vouched_.size() >= kAddressesMax && !vouched_.contains(certificate)) {
    absl::erase_if(vouched_, [&](auto& each) {
      absl::erase_if(each.second, over);
      return each.second.empty();
    });
    if (vouched_.size() >= kAddressesMax) return false;
  }
  auto& addresses = vouched_[certificate];
  if (addresses.size() >= kVouchedMax && !addresses.contains(address)) {
    absl::erase_if(addresses, over);
    if (addresses.size() >= kVouchedMax) return false;
  }
  addresses[address] = now_ns + kKnownNs;
  return true;
}

void Admission::Identified(const Source& source, const std::string& certificate, int64_t now_ns) {
  Address& address = Touch(source.address, now_ns);
  if (MayVouch(source.address, certificate, now_ns)) address.known_until_ns = now_ns + kKnownNs;
}

bool Admission::AtHome(const std::string& address, const std::string& certificate,
                       int64_t now_ns) const {
  const auto vouched = vouched_.find(certificate);
  if (vouched == vouched_.end()) return false;
  const auto at = vouched->second.find(address);
  return at != vouched->second.end() && now_ns < at->second;
}

int Admission::InNetwork(const Source& source) const {
  const auto it = networks_.find(source.network);
  return it == networks_.end() ? 0 : it->second;
}

bool Admission::Known(const Source& source, int64_t now_ns) const {
  const auto it = addresses_.find(source.address);
  return it != addresses_.end() && now_ns < it->second.known_until_ns;
}

int64_t Admission::Ban(const Source& source, int64_t now_ns) {
  Address& address = Touch(source.address, now_ns);
  const bool again = address.ban_ns > 0 && now_ns - address.banned_until_ns < kKnownNs;
  // Several of its connections may be ended for one attack.
  if (now_ns < address.banned_until_ns) return address.banned_until_ns - now_ns;
  address.ban_ns = again ? std::min(2 * address.ban_ns, kBanNsMax) : kBanNs;
  address.banned_until_ns = now_ns + address.ban_ns;
  address.tokens = std::min(address.tokens, 1.0);
  return address.ban_ns;
}

absl::string_view ToString(Admission::Verdict verdict) {
  switch (verdict) {
    case Admission::Verdict::kTake:
      return "taken";
    case Admission::Verdict::kBanned:
      return "banned";
    case Admission::Verdict::kRate:
      return "rate";
    case Admission::Verdict::kAddress:
      return "address";
    case Admission::Verdict::kNetwork:
      return "network";
    case Admission::Verdict::kTotal:
      return "total";
  }
  return "unknown";
}

}  // namespace rips::rpc
