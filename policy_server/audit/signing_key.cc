#include "policy_server/audit/signing_key.h"

#include <utility>

#include "policy_server/audit/format.h"

namespace rips::audit {
namespace {

struct FreeContext {
  void operator()(EVP_MD_CTX* context) const { EVP_MD_CTX_free(context); }
};
using DigestContext = std::unique_ptr<EVP_MD_CTX, FreeContext>;

const unsigned char* Bytes(absl::string_view text) {
  return reinterpret_cast<const unsigned char*>(text.data());
}
unsigned char* Bytes(std::string& text) { return reinterpret_cast<unsigned char*>(text.data()); }

absl::Status Failed(absl::string_view what) {
  return absl::InternalError(std::string(what) + " failed in OpenSSL");
}

}  // namespace

absl::StatusOr<SigningKey> SigningKey::Of(Key key) {
  std::string bytes(kPublicKeyBytes, '\0');
  size_t size = bytes.size();
  if (key == nullptr || EVP_PKEY_get_raw_public_key(key.get(), Bytes(bytes), &size) != 1) {
    return Failed("making an Ed25519 key");
  }
  return SigningKey(std::move(key), std::move(bytes));
}

absl::StatusOr<SigningKey> SigningKey::Generate() {
  return Of(Key(EVP_PKEY_Q_keygen(nullptr, nullptr, "ED25519")));
}

absl::StatusOr<SigningKey> SigningKey::FromPrivate(absl::string_view bytes) {
  Key key(EVP_PKEY_new_raw_private_key(EVP_PKEY_ED25519, nullptr, Bytes(bytes), bytes.size()));
  if (key == nullptr) return absl::InvalidArgumentError("not the 32 bytes of an Ed25519 key");
  return Of(std::move(key));
}

absl::StatusOr<std::string> SigningKey::private_bytes() const {
  std::string bytes(kPublicKeyBytes, '\0');
  size_t size = bytes.size();
  if (EVP_PKEY_get_raw_private_key(key_.get(), Bytes(bytes), &size) != 1) {
    return Failed("reading an Ed25519 key");
  }
  return bytes;
}

absl::StatusOr<std::string> SigningKey::Sign(absl::string_view message) const {
  const DigestContext context(EVP_MD_CTX_new());
  std::string signature(kSignatureBytes, '\0');
  size_t size = signature.size();
  if (context == nullptr ||
      EVP_DigestSignInit(context.get(), nullptr, nullptr, nullptr, key_.get()) != 1 ||
      EVP_DigestSign(context.get(), Bytes(signature), &size, Bytes(message), message.size()) != 1) {
    return Failed("signing");
  }
  return signature;
}

bool IsSignedBy(absl::string_view public_key, absl::string_view message,
                absl::string_view signature) {
  EVP_PKEY* raw =
      EVP_PKEY_new_raw_public_key(EVP_PKEY_ED25519, nullptr, Bytes(public_key), public_key.size());
  const DigestContext context(EVP_MD_CTX_new());
  const bool good = raw != nullptr && context != nullptr &&
                    EVP_DigestVerifyInit(context.get(), nullptr, nullptr, nullptr, raw) == 1 &&
                    EVP_DigestVerify(context.get(), Bytes(signature), signature.size(),
                                     Bytes(message), message.size()) == 1;
  EVP_PKEY_free(raw);
  return good;
}

}  // namespace rips::audit
