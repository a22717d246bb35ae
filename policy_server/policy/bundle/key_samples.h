// Keys in PEM, made anew for each test. Test code only.
#ifndef RIPS_POLICY_SERVER_POLICY_BUNDLE_KEY_SAMPLES_H_
#define RIPS_POLICY_SERVER_POLICY_BUNDLE_KEY_SAMPLES_H_

#include <openssl/bio.h>
#include <openssl/evp.h>
#include <openssl/pem.h>

#include <string>

#include "services/base/check.h"

namespace rips::bundle {

struct SampleKey {
  std::string private_pem;
  std::string public_pem;
  // The private key under the password `secret`.
  std::string encrypted_pem;
};

inline std::string TakePem(BIO* bio, int wrote) {
  char* data = nullptr;
  const long size = BIO_get_mem_data(bio, &data);
  RIPS_CHECK(wrote == 1 && size > 0, "OpenSSL writes keys");
  std::string pem(data, static_cast<size_t>(size));
  BIO_free(bio);
  return pem;
}

// `key` is freed.
inline SampleKey ToSampleKey(EVP_PKEY* key) {
  RIPS_CHECK(key != nullptr, "OpenSSL makes keys");
  SampleKey sample;
  BIO* bio = BIO_new(BIO_s_mem());
  int wrote = PEM_write_bio_PrivateKey(bio, key, nullptr, nullptr, 0, nullptr, nullptr);
  sample.private_pem = TakePem(bio, wrote);
  bio = BIO_new(BIO_s_mem());
  wrote = PEM_write_bio_PUBKEY(bio, key);
  sample.public_pem = TakePem(bio, wrote);
  bio = BIO_new(BIO_s_mem());
  unsigned char password[] = "secret";
  wrote = PEM_write_bio_PKCS8PrivateKey(bio, key, EVP_aes_128_cbc(),
                                        reinterpret_cast<char*>(password), 6, nullptr, nullptr);
  sample.encrypted_pem = TakePem(bio, wrote);
  EVP_PKEY_free(key);
  return sample;
}

inline SampleKey MakeEd25519() {
  return ToSampleKey(EVP_PKEY_Q_keygen(nullptr, nullptr, "ED25519"));
}
// Of other kinds.
inline SampleKey MakeRsa() {
  return ToSampleKey(EVP_PKEY_Q_keygen(nullptr, nullptr, "RSA", size_t{2048}));
}
inline SampleKey MakeX25519() { return ToSampleKey(EVP_PKEY_Q_keygen(nullptr, nullptr, "X25519")); }

}  // namespace rips::bundle

#endif  // RIPS_POLICY_SERVER_POLICY_BUNDLE_KEY_SAMPLES_H_
