// An Ed25519 key pair (RFC 8032) of one segment.
#ifndef RIPS_POLICY_SERVER_AUDIT_SIGNING_KEY_H_
#define RIPS_POLICY_SERVER_AUDIT_SIGNING_KEY_H_

#include <openssl/evp.h>

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::audit {

class SigningKey {
 public:
  // From the system's random source. Internal if there is none.
  static absl::StatusOr<SigningKey> Generate();
  // 32 bytes, as private_bytes gives them; InvalidArgument otherwise.
  static absl::StatusOr<SigningKey> FromPrivate(absl::string_view bytes);

  const std::string& public_key() const { return public_key_; }
  // Secret.
  absl::StatusOr<std::string> private_bytes() const;
  // kSignatureBytes. One thread at a time.
  absl::StatusOr<std::string> Sign(absl::string_view message) const;

 private:
  struct Free {
    void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
  };
  using Key = std::unique_ptr<EVP_PKEY, Free>;

  static absl::StatusOr<SigningKey> Of(Key key);
  SigningKey(Key key, std::string public_key)
      : key_(std::move(key)), public_key_(std::move(public_key)) {}

  Key key_;
  std::string public_key_;
};

// False also for a key or a signature of another length.
bool IsSignedBy(absl::string_view public_key, absl::string_view message,
                absl::string_view signature);

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_AUDIT_SIGNING_KEY_H_
