// Signs certificates of agents with an issuing key, as deploy/pki/mint does.
#ifndef RIPS_SERVICES_PKI_ISSUER_H_
#define RIPS_SERVICES_PKI_ISSUER_H_

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/rpc/identity.h"

namespace rips::pki {

inline constexpr size_t kRequestBytesMax = 8'192;
// A certificate begins so long before it is made: clocks of robots are behind.
inline constexpr absl::Duration kBackdated = absl::Minutes(5);

// What a certificate is asked for: a key, which its holder has proven, and nothing else.
class CertificateRequest {
 public:
  // InvalidArgument, saying why, for what is no PKCS#10 request in PEM of at most kRequestBytesMax;
  // one that its key has not signed; a key that is not P-256, P-384 or RSA of 3,072 to 4,096 bits;
  // a request with a subject or extensions, because no agent chooses its name.
  static absl::StatusOr<CertificateRequest> Read(absl::string_view pem);
  CertificateRequest(CertificateRequest&&) noexcept;
  CertificateRequest& operator=(CertificateRequest&&) noexcept;
  ~CertificateRequest();

  // SHA-256 of the public key, lower-case hex.
  const std::string& key_hash() const { return key_hash_; }

 private:
  friend class Issuer;
  struct Key;
  CertificateRequest(std::unique_ptr<Key> key, std::string key_hash);

  std::unique_ptr<Key> key_;
  std::string key_hash_;
};

struct Issued {
  // The certificate, then those of the issuer; PEM.
  std::string certificates_pem;
  // Lower-case hex, no leading zeros.
  std::string serial;
  absl::Time not_after;
};

// Any thread.
class Issuer {
 public:
  // `certificates_pem`: the issuing certificate, then any between it and a root of `ca_pem`.
  // InvalidArgument if it may not sign certificates, does not chain to `ca_pem` (its times are
  // looked at by Sign), or `key_pem` is not its key.
  static absl::StatusOr<Issuer> Read(absl::string_view certificates_pem, absl::string_view key_pem,
                                     absl::string_view ca_pem);
  Issuer(Issuer&&) noexcept;
  Issuer& operator=(Issuer&&) noexcept;
  ~Issuer();

  // A client's certificate whose one name is the URI of `identity`, good from kBackdated before
  // `now` until `now + life`, or until the issuer's own end. FailedPrecondition if the issuing
  // certificate is not valid at `now`.
  absl::StatusOr<Issued> Sign(const CertificateRequest& request, const rpc::PeerIdentity& identity,
                              absl::Time now, absl::Duration life) const;

 private:
  struct Authority;
  explicit Issuer(std::unique_ptr<Authority> authority);

  std::unique_ptr<Authority> authority_;
};

}  // namespace rips::pki

#endif  // RIPS_SERVICES_PKI_ISSUER_H_
