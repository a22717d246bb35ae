// Verifies a certificate that another authority signed for us: it is what was asked for, and
// nothing more. Any thread.
//
// | of the certificate       | must be                                                            |
// |--------------------------|--------------------------------------------------------------------|
// | public key               | that of the request                                                |
// | subject alternative name | one name, the URI of the identity                                  |
// | subject                  | empty, or one common name: `RIPS ROLE`, or that URI                |
// | basic constraints        | absent, or CA:FALSE                                                |
// | key usage                | digitalSignature; extended: clientAuth (as Issuer)                 |
// | serial number            | positive, at most 20 bytes (RFC 5280 §4.1.2.2)                     |
// | begin                    | no later than kBeginsLateMax from now                              |
// | end                      | after now, and no later than the life asked for and kLongerMax from|
// |                          | now, and from its begin                                            |
// | chain                    | leads to a root that agents trust, valid, for clients              |
#ifndef RIPS_SERVICES_PKI_CERTIFICATE_CHECK_H_
#define RIPS_SERVICES_PKI_CERTIFICATE_CHECK_H_

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/pki/issuer.h"
#include "services/rpc/identity.h"

namespace rips::pki {

// Certificates in one answer.
inline constexpr size_t kChainMax = 8;
// What the clocks of the authority and of this host may differ.
inline constexpr absl::Duration kBeginsLateMax = absl::Minutes(1);
// An authority may count in whole days.
inline constexpr absl::Duration kLongerMax = absl::Hours(24);

struct CertificateOrder {
  const CertificateRequest* request = nullptr;  // not owned
  rpc::PeerIdentity identity;
  absl::Time now;
  absl::Duration life;
};

// `certificates_pem`: the certificate, then those between it and a root of `ca_pem`, which may be
// among them; PEM, and nothing else, because what stands beside them could be a key. The result has
// of them the certificates of the verified chain, without the root. InvalidArgument, naming what
// differs from the table.
absl::StatusOr<Issued> CheckIssued(absl::string_view certificates_pem,
                                   const CertificateOrder& order, absl::string_view ca_pem);

}  // namespace rips::pki

#endif  // RIPS_SERVICES_PKI_CERTIFICATE_CHECK_H_
