#include "services/rpc/peer_address.h"

#include <cstdint>

#include "absl/strings/numbers.h"
#include "absl/strings/strip.h"

namespace rips::rpc {

std::string DecodePeer(absl::string_view peer) {
  std::string out;
  for (size_t i = 0; i < peer.size(); ++i) {
    uint32_t byte = 0;
    if (peer[i] == '%' && i + 2 < peer.size() &&
        absl::SimpleHexAtoi(peer.substr(i + 1, 2), &byte)) {
      out.push_back(static_cast<char>(byte));
      i += 2;
    } else {
      out.push_back(peer[i]);
    }
  }
  return out;
}

std::string AddressOfPeer(absl::string_view peer) {
  const std::string decoded = DecodePeer(peer);
  absl::string_view text = decoded;
  const size_t port = text.rfind(':');
  if (port == absl::string_view::npos) return "";
  text.remove_suffix(text.size() - port);
  if (absl::ConsumePrefix(&text, "ipv4:")) return std::string(text);
  if (!absl::ConsumePrefix(&text, "ipv6:[") || !absl::ConsumeSuffix(&text, "]")) return "";
  text = text.substr(0, text.find('%'));  // the scope of a link-local address
  const absl::string_view whole = text;
  const bool carried = absl::ConsumePrefix(&text, "::ffff:") && text.find('.') != text.npos;
  return std::string(carried ? text : whole);
}

}  // namespace rips::rpc
