// What the files of this folder share of libcrypto. Inside services/pki only; any thread.
#ifndef RIPS_SERVICES_PKI_OPENSSL_REQUEST_H_
#define RIPS_SERVICES_PKI_OPENSSL_REQUEST_H_

#include <openssl/x509.h>

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/rpc/openssl_types.h"

namespace rips::pki {

using Request = std::unique_ptr<X509_REQ, rpc::openssl::Freer<X509_REQ_free>>;

// InvalidArgument if there is no unencrypted private key in it.
absl::StatusOr<rpc::openssl::Key> ReadKey(absl::string_view key_pem);
// SHA-256 of the public half, lower-case hex.
absl::StatusOr<std::string> HashOf(EVP_PKEY* key);
absl::StatusOr<std::string> ToPem(X509* certificate);

}  // namespace rips::pki

#endif  // RIPS_SERVICES_PKI_OPENSSL_REQUEST_H_
