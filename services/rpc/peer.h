// Who is at the other end of a call, from its certificate alone.
#ifndef RIPS_SERVICES_RPC_PEER_H_
#define RIPS_SERVICES_RPC_PEER_H_

#include <string>

#include "absl/status/statusor.h"
#include "grpcpp/security/auth_context.h"
#include "services/rpc/certificate.h"

namespace rips::rpc {

// `spiffe://td/operator/admin/alice serial 0f3a`: what records name.
std::string Describe(const Peer& peer);

// The peer of a call: `PeerOf(*context->auth_context())`. Uses the one URI SAN, never the common
// name or the address. Unauthenticated if there is no verified certificate, not exactly one URI,
// or it is not a form of ParseSpiffeUri. Any thread; also in a reactor's constructor.
absl::StatusOr<Peer> PeerOf(const grpc::AuthContext& auth);

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_PEER_H_
