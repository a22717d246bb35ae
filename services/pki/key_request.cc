#include "services/pki/key_request.h"

#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/x509.h>

#include "services/base/status_macros.h"
#include "services/pki/openssl_request.h"
#include "services/rpc/openssl_types.h"

namespace rips::pki {
namespace {

using rpc::openssl::Bio;
using rpc::openssl::Key;

std::string TextIn(BIO* bio) {
  char* data = nullptr;
  const long size = BIO_get_mem_data(bio, &data);
  return size > 0 ? std::string(data, static_cast<size_t>(size)) : std::string();
}

}  // namespace

absl::StatusOr<Key> ReadKey(absl::string_view key_pem) {
  const Bio bio(BIO_new_mem_buf(key_pem.data(), static_cast<int>(key_pem.size())));
  Key key(PEM_read_bio_PrivateKey(bio.get(), nullptr, rpc::openssl::NoPassword, nullptr));
  ERR_clear_error();
  if (key == nullptr) return absl::InvalidArgumentError("there is no unencrypted private key");
  return key;
}

absl::StatusOr<std::string> HashOf(EVP_PKEY* key) {
  unsigned char* der = nullptr;
  const int size = i2d_PUBKEY(key, &der);
  if (size <= 0) return absl::InvalidArgumentError("a public key cannot be encoded");
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned int digest_size = 0;
  const int done = EVP_Digest(der, static_cast<size_t>(size), digest, &digest_size, EVP_sha256(),
                              /*impl=*/nullptr);
  OPENSSL_free(der);
  if (done != 1) return absl::InternalError("libcrypto cannot hash a key");
  constexpr char kDigits[] = "0123456789abcdef";
  std::string hex;
  for (unsigned int i = 0; i < digest_size; ++i) {
    hex += kDigits[digest[i] >> 4];
    hex += kDigits[digest[i] & 15];
  }
  return hex;
}

absl::StatusOr<std::string> NewKey() {
  const Key key(EVP_PKEY_Q_keygen(nullptr, nullptr, "EC", "P-256"));
  const Bio out(BIO_new(BIO_s_mem()));
  if (key == nullptr || out == nullptr ||
      PEM_write_bio_PKCS8PrivateKey(out.get(), key.get(), nullptr, nullptr, 0, nullptr, nullptr) !=
          1) {
    ERR_clear_error();
    return absl::InternalError("libcrypto cannot make a key");
  }
  return TextIn(out.get());
}

absl::StatusOr<std::string> RequestFor(absl::string_view key_pem) {
  RIPS_ASSIGN_OR_RETURN(const Key key, ReadKey(key_pem));
  const Request request(X509_REQ_new());
  const Bio out(BIO_new(BIO_s_mem()));
  if (request == nullptr || out == nullptr || X509_REQ_set_version(request.get(), 0) != 1 ||
      X509_REQ_set_pubkey(request.get(), key.get()) != 1 ||
      X509_REQ_sign(request.get(), key.get(), EVP_sha256()) <= 0 ||
      PEM_write_bio_X509_REQ(out.get(), request.get()) != 1) {
    ERR_clear_error();
    return absl::InternalError("libcrypto cannot make a request for a certificate");
  }
  return TextIn(out.get());
}

absl::StatusOr<std::string> PublicKeyHash(absl::string_view key_pem) {
  RIPS_ASSIGN_OR_RETURN(const Key key, ReadKey(key_pem));
  return HashOf(key.get());
}

}  // namespace rips::pki
