// Reading certificates with libcrypto. Inside services/rpc only; any thread.
#ifndef RIPS_SERVICES_RPC_CERTIFICATE_H_
#define RIPS_SERVICES_RPC_CERTIFICATE_H_

#include <compare>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/rpc/identity.h"

namespace rips::rpc {

// How a revocation list names a certificate.
struct CertificateId {
  std::string issuer;  // distinguished name, DER
  std::string serial;  // lower-case hex, no leading zeros

  friend auto operator<=>(const CertificateId&, const CertificateId&) = default;
};

// The holder of a certificate: the other end of a call, or ourselves.
struct Peer {
  PeerIdentity identity;
  // When its certificate expires. The library does not end a live stream then: the service must.
  absl::Time not_after;
  absl::Time not_before;
  // Of its certificate, as in CertificateId.
  std::string serial;
  // Of the other end of a call: its certificate and the authorities between it and the root.
  std::vector<CertificateId> chain = {};
};

// The first certificate in `pem`. InvalidArgument if there is none, if it has not exactly one URI
// SAN (RFC 5280 §4.2.1.6), or if that is not a form of ParseSpiffeUri. Without the
// chain; proves nothing about trust.
absl::StatusOr<Peer> ReadLeaf(absl::string_view pem);

// All certificates in `pem`, in order, those issued by themselves left out.
std::vector<CertificateId> ReadChain(absl::string_view pem);

// OK if the first certificate of `cert_pem` belongs to the private key, is valid now, and chains
// through the rest of `cert_pem` to one of `ca_pem`. InvalidArgument, with the reason, otherwise.
absl::Status CheckChain(absl::string_view ca_pem, absl::string_view cert_pem,
                        absl::string_view key_pem);

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_CERTIFICATE_H_
