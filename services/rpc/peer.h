// Who is at the other end of a call, from its certificate alone.
#ifndef RIPS_SERVICES_RPC_PEER_H_
#define RIPS_SERVICES_RPC_PEER_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "grpcpp/security/auth_context.h"
#include "services/rpc/certificate.h"
#include "services/rpc/identity.h"

namespace rips::rpc {

struct Peer {
  PeerIdentity identity;
  // When its certificate expires. The library does not end a live stream then: the service must.
  absl::Time not_after;
  absl::Time not_before;
  // Of its certificate; lower-case hex.
  std::string serial;
  // Its certificate and the authorities between it and the root, as revocation lists name them.
  std::vector<CertificateId> chain;
};

// `spiffe://td/operator/admin/alice serial 0f3a`: what records name.
std::string Describe(const Peer& peer);

// The peer of a call: `PeerOf(*context->auth_context())`. Uses the one URI SAN, never the common
// name or the address. Unauthenticated if there is no verified certificate, not exactly one URI,
// or it is not a form of ParseSpiffeUri. Any thread; also in a reactor's constructor.
absl::StatusOr<Peer> PeerOf(const grpc::AuthContext& auth);

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_PEER_H_
