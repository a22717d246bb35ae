#include "sensor_agent/wire/locator.h"

#include <arpa/inet.h>

#include <algorithm>
#include <iterator>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"

namespace rips::wire {

namespace {

constexpr size_t kV4At = 12;
constexpr std::array<uint8_t, kV4At> kMapped = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff};
constexpr uint32_t kPortMax = 65'535;

bool ParseAddress(const std::string& text, Address& address) {
  uint8_t octets[16];
  if (inet_pton(AF_INET, text.c_str(), octets) == 1) {
    address = FromV4(octets);
    return true;
  }
  if (inet_pton(AF_INET6, text.c_str(), octets) == 1) {
    address = FromV6(octets);
    return true;
  }
  return false;
}

// "10.0.0.2:41234" or "[fe80::1]:41234".
bool ParseLocator(absl::string_view text, Locator& locator) {
  const size_t colon = text.rfind(':');
  if (colon == absl::string_view::npos) return false;
  absl::string_view host = text.substr(0, colon);
  uint32_t port = 0;
  if (!absl::SimpleAtoi(text.substr(colon + 1), &port) || port > kPortMax) return false;
  locator.port = static_cast<uint16_t>(port);
  if (absl::ConsumePrefix(&host, "[") && !absl::ConsumeSuffix(&host, "]")) return false;
  // The scope of a link-local address.
  host = host.substr(0, host.find('%'));
  return ParseAddress(std::string(host), locator.address);
}

}  // namespace

bool Address::v4() const { return std::equal(kMapped.begin(), kMapped.end(), bytes.begin()); }

bool Address::multicast() const { return v4() ? (bytes[kV4At] & 0xf0) == 0xe0 : bytes[0] == 0xff; }

bool Address::loopback() const {
  if (v4()) return bytes[kV4At] == 127;
  return bytes[15] == 1 &&
         std::all_of(bytes.begin(), bytes.end() - 1, [](uint8_t b) { return b == 0; });
}

Address FromV4(const uint8_t* octets) {
  Address address;
  std::copy(kMapped.begin(), kMapped.end(), address.bytes.begin());
  std::copy(octets, octets + 4, address.bytes.begin() + kV4At);
  return address;
}

Address FromV6(const uint8_t* octets) {
  Address address;
  std::copy(octets, octets + address.bytes.size(), address.bytes.begin());
  return address;
}

std::string ToString(const Address& address) {
  char text[INET6_ADDRSTRLEN] = "";
  if (address.v4()) {
    inet_ntop(AF_INET, address.bytes.data() + kV4At, text, sizeof text);
  } else {
    inet_ntop(AF_INET6, address.bytes.data(), text, sizeof text);
  }
  return text;
}

std::string ToString(const Locator& locator) {
  const std::string address = ToString(locator.address);
  return locator.address.v4() ? absl::StrCat(address, ":", locator.port)
                              : absl::StrCat("[", address, "]:", locator.port);
}

std::vector<Locator> ParseLocators(absl::string_view text) {
  std::vector<Locator> locators;
  for (absl::string_view each : absl::StrSplit(text, ',')) {
    if (locators.size() == kAdvertisedMax) break;
    if (!absl::ConsumePrefix(&each, "udp/") && !absl::ConsumePrefix(&each, "udp6/")) continue;
    Locator locator;
    if (ParseLocator(each.substr(0, each.find('@')), locator)) locators.push_back(locator);
  }
  return locators;
}

std::string FirstAddress(absl::string_view text) {
  std::string first;
  for (const Locator& each : ParseLocators(text)) {
    if (each.address.multicast()) continue;
    if (!each.address.loopback()) return ToString(each.address);
    if (first.empty()) first = ToString(each.address);
  }
  return first;
}

}  // namespace rips::wire
