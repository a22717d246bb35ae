// New private keys, and requests for certificates of them (PKCS#10, RFC 2986).
#ifndef RIPS_SERVICES_PKI_KEY_REQUEST_H_
#define RIPS_SERVICES_PKI_KEY_REQUEST_H_

#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::pki {

// A new P-256 key: PKCS#8 in PEM, not encrypted.
absl::StatusOr<std::string> NewKey();

// A request for a certificate of the key, in PEM: without subject and extensions, because what the
// holder is comes from elsewhere. InvalidArgument if `key_pem` is no key.
absl::StatusOr<std::string> RequestFor(absl::string_view key_pem);

// SHA-256 of the public half, lower-case hex. InvalidArgument if `key_pem` is no key.
absl::StatusOr<std::string> PublicKeyHash(absl::string_view key_pem);

}  // namespace rips::pki

#endif  // RIPS_SERVICES_PKI_KEY_REQUEST_H_
