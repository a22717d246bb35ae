#include "services/rpc/peer.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "grpc/grpc_security_constants.h"
#include "services/rpc/certificate.h"

namespace rips::rpc {

absl::StatusOr<Peer> PeerOf(const grpc::AuthContext& auth) {
  const std::vector<grpc::string_ref> certificates =
      auth.FindPropertyValues(GRPC_X509_PEM_CERT_PROPERTY_NAME);
  if (!auth.IsPeerAuthenticated() || certificates.size() != 1) {
    return absl::UnauthenticatedError("no verified certificate; connect with mutual TLS");
  }
  absl::StatusOr<Peer> peer =
      ReadLeaf(absl::string_view(certificates[0].data(), certificates[0].size()));
  if (!peer.ok()) return absl::UnauthenticatedError(peer.status().message());
  for (const char* property :
       {GRPC_X509_PEM_CERT_PROPERTY_NAME, GRPC_X509_PEM_CERT_CHAIN_PROPERTY_NAME}) {
    for (const grpc::string_ref& pem : auth.FindPropertyValues(property)) {
      for (CertificateId& each : ReadChain(absl::string_view(pem.data(), pem.size()))) {
        const bool known =
            std::find(peer->chain.begin(), peer->chain.end(), each) != peer->chain.end();
        if (!known) peer->chain.push_back(std::move(each));
      }
    }
  }
  return peer;
}

std::string Describe(const Peer& peer) {
  return absl::StrCat(ToString(peer.identity), " serial ", peer.serial);
}

}  // namespace rips::rpc
