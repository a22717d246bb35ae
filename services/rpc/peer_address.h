// Names of peers as grpc::ServerContextBase::peer() gives them.
#ifndef RIPS_SERVICES_RPC_PEER_ADDRESS_H_
#define RIPS_SERVICES_RPC_PEER_ADDRESS_H_

#include <string>

#include "absl/strings/string_view.h"

namespace rips::rpc {

// How gRPC names a peer, percent-decoded.
std::string DecodePeer(absl::string_view peer);

// `fd00::7` of `ipv6:%5Bfd00::7%5D:4711`, `10.0.0.7` of `ipv4:10.0.0.7:4711`; the same for an IPv4
// address that IPv6 carries. Empty for anything else.
std::string AddressOfPeer(absl::string_view peer);

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_PEER_ADDRESS_H_
