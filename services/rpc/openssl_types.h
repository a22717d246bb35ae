// Owning pointers to libcrypto's objects, and the few readings of them that several files need.
// Inside services/rpc and services/pki only; any thread.
#ifndef RIPS_SERVICES_RPC_OPENSSL_TYPES_H_
#define RIPS_SERVICES_RPC_OPENSSL_TYPES_H_

#include <openssl/bio.h>
#include <openssl/evp.h>
#include <openssl/x509.h>
#include <openssl/x509_vfy.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"

namespace rips::rpc::openssl {

template <auto Free>
struct Freer {
  template <typename T>
  void operator()(T* object) const {
    Free(object);
  }
};
using Bio = std::unique_ptr<BIO, Freer<BIO_free>>;
using Certificate = std::unique_ptr<X509, Freer<X509_free>>;
using Crl = std::unique_ptr<X509_CRL, Freer<X509_CRL_free>>;
using Key = std::unique_ptr<EVP_PKEY, Freer<EVP_PKEY_free>>;
using Store = std::unique_ptr<X509_STORE, Freer<X509_STORE_free>>;
using StoreContext = std::unique_ptr<X509_STORE_CTX, Freer<X509_STORE_CTX_free>>;

struct FreeStack {
  void operator()(STACK_OF(X509) * stack) const { sk_X509_free(stack); }
};

// An encrypted key is refused instead of asking for its password on the terminal.
inline int NoPassword(char*, int, int, void*) { return 0; }

// Up to the first thing that is no certificate.
std::vector<Certificate> ReadCertificates(absl::string_view pem);
// Lower-case hex without leading zeros; empty if libcrypto cannot.
std::string SerialText(const ASN1_INTEGER* serial);
// DER; empty if libcrypto cannot.
std::string NameText(const X509_NAME* name);
absl::StatusOr<absl::Time> ToTime(const ASN1_TIME* time);

}  // namespace rips::rpc::openssl

#endif  // RIPS_SERVICES_RPC_OPENSSL_TYPES_H_
