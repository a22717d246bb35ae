#include "services/rpc/peer.h"

#include <string>
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
  const absl::StatusOr<Leaf> leaf =
      ReadLeaf(absl::string_view(certificates[0].data(), certificates[0].size()));
  if (!leaf.ok()) return absl::UnauthenticatedError(leaf.status().message());
  return Peer{.identity = leaf->identity, .not_after = leaf->not_after};
}

}  // namespace rips::rpc
