#include "services/dds/address_watch.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace rips::dds {
namespace {

bool IsThere(const InterfaceAddress& used, const std::vector<InterfaceAddress>& host) {
  return std::any_of(host.begin(), host.end(),
                     [&](const InterfaceAddress& each) { return each.Is(used); });
}

// ddsi_ownip.c: never a link-local address before another, loopback last of all.
int Quality(const InterfaceAddress& address) {
  if (address.loopback) return address.link_local ? 0 : 1;
  const int reach = address.multicast ? 4 : address.point_to_point ? 2 : 3;
  return reach + (address.link_local ? 0 : 5);
}

// What a domain would take in place of `gone`; null = nothing.
const InterfaceAddress* Successor(const InterfaceAddress& gone, bool automatic,
                                  const std::vector<InterfaceAddress>& host) {
  if (automatic) return CycloneChoice(host, gone.ipv6);
  const auto found = std::find_if(host.begin(), host.end(), [&](const InterfaceAddress& each) {
    return each.interface == gone.interface && each.ipv6 == gone.ipv6;
  });
  return found == host.end() ? nullptr : &*found;
}

std::string Describe(const InterfaceAddress& gone, const InterfaceAddress* next) {
  if (next == nullptr) {
    return absl::StrCat(gone.interface, " lost ", gone.address, " and has no other address");
  }
  if (next->interface != gone.interface) {
    return absl::StrCat(gone.interface, " lost ", gone.address, "; ", next->interface, " has ",
                        next->address);
  }
  if (next->address == gone.address) {
    return absl::StrCat(gone.interface, " with ", gone.address, " was made again");
  }
  return absl::StrCat(gone.interface, " had ", gone.address, " and has ", next->address);
}

}  // namespace

const InterfaceAddress* CycloneChoice(const std::vector<InterfaceAddress>& host, bool ipv6) {
  const InterfaceAddress* best = nullptr;
  for (const InterfaceAddress& each : host) {
    if (each.ipv6 != ipv6) continue;
    if (best == nullptr || Quality(each) > Quality(*best)) best = &each;
  }
  return best;
}

bool AddressWatch::TakeTurn(int64_t now_ns) {
  if (turns_ < kBurst) {
    const int64_t back = (now_ns - turns_from_ns_) / kTurnNs;
    turns_ = static_cast<int>(std::min<int64_t>(kBurst, turns_ + back));
    turns_from_ns_ += back * kTurnNs;
  }
  if (turns_ == 0) return false;
  if (turns_-- == kBurst) turns_from_ns_ = now_ns;
  return true;
}

bool AddressWatch::Look(const InterfacesInUse& in_use, const std::vector<InterfaceAddress>& host,
                        int64_t now_ns) {
  std::string differs;
  bool gone = false;
  bool replaced = true;
  for (const InterfaceAddress& used : in_use.addresses) {
    if (IsThere(used, host)) continue;
    const InterfaceAddress* next = Successor(used, in_use.automatic, host);
    absl::StrAppend(&differs, gone ? ", " : "", Describe(used, next));
    gone = true;
    replaced = replaced && next != nullptr && next->interface == used.interface;
  }
  if (!gone && in_use.automatic && in_use.addresses.size() == 1) {
    const InterfaceAddress& used = in_use.addresses.front();
    const InterfaceAddress* choice = CycloneChoice(host, used.ipv6);
    if (choice != nullptr && choice->interface != used.interface) {
      differs = absl::StrCat(choice->interface, " came with ", choice->address, "; ",
                             used.interface, " with ", used.address, " was used");
    }
  }
  if (differs != differs_) differs_since_ns_ = now_ns;
  differs_ = differs;
  if (!gone) gone_since_ns_.reset();
  if (gone && !gone_since_ns_.has_value()) gone_since_ns_ = now_ns;
  if (!gone && !ended_) problem_.clear();  // it came back in time
  if (differs.empty()) return false;
  if (gone && problem_.empty()) problem_ = differs;
  // Half a look less: looks are never exactly as far apart as they should be.
  const int64_t stood_ns = now_ns - differs_since_ns_ + kLookNs / 2;
  const bool due = !gone      ? stood_ns >= kBetterNs
                   : replaced ? stood_ns >= kLookNs
                              : now_ns - *gone_since_ns_ + kLookNs / 2 >= kGoneNs;
  if (!due || !TakeTurn(now_ns)) return false;
  change_ = differs;
  if (problem_.empty()) problem_ = differs;
  ended_ = true;
  differs_.clear();
  gone_since_ns_.reset();
  attempted_ = host;
  attempted_ns_ = now_ns;
  return true;
}

bool AddressWatch::MayBegin(const std::vector<InterfaceAddress>& host, int64_t now_ns) {
  std::vector<InterfaceAddress> usable;
  for (const InterfaceAddress& each : host) {
    if (interface_.empty() || each.interface == interface_) usable.push_back(each);
  }
  if (usable.empty()) {
    attempted_.clear();
    return false;
  }
  const int64_t wait_ns = usable == attempted_ ? kAttemptAnywayNs : kAttemptNs;
  if (attempted_ns_.has_value() && now_ns - *attempted_ns_ < wait_ns) return false;
  attempted_ = std::move(usable);
  attempted_ns_ = now_ns;
  return true;
}

void AddressWatch::SeenAgain() {
  if (gone_since_ns_.has_value()) return;
  problem_.clear();
  ended_ = false;
}

}  // namespace rips::dds
