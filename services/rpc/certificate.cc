#include "services/rpc/certificate.h"

#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <openssl/x509_vfy.h>
#include <openssl/x509v3.h>

#include <ctime>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::rpc {
namespace {

template <auto Free>
struct Freer {
  template <typename T>
  void operator()(T* object) const {
    Free(object);
  }
};
using Bio = std::unique_ptr<BIO, Freer<BIO_free>>;
using Certificate = std::unique_ptr<X509, Freer<X509_free>>;
using Key = std::unique_ptr<EVP_PKEY, Freer<EVP_PKEY_free>>;
using Store = std::unique_ptr<X509_STORE, Freer<X509_STORE_free>>;
using StoreContext = std::unique_ptr<X509_STORE_CTX, Freer<X509_STORE_CTX_free>>;
using Names = std::unique_ptr<GENERAL_NAMES, Freer<GENERAL_NAMES_free>>;

struct FreeStack {
  void operator()(STACK_OF(X509) * stack) const { sk_X509_free(stack); }
};

// An encrypted key is refused instead of asking for its password on the terminal.
int NoPassword(char*, int, int, void*) { return 0; }

std::vector<Certificate> ReadCertificates(absl::string_view pem) {
  std::vector<Certificate> certificates;
  const Bio bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  while (X509* next = PEM_read_bio_X509(bio.get(), nullptr, NoPassword, nullptr)) {
    certificates.emplace_back(next);
  }
  ERR_clear_error();  // the end of the text counts as one
  return certificates;
}

// All URI SANs; an unreadable or repeated extension gives none.
std::vector<std::string> UriNames(const X509* certificate) {
  std::vector<std::string> uris;
  const Names names(static_cast<GENERAL_NAMES*>(
      X509_get_ext_d2i(certificate, NID_subject_alt_name, nullptr, nullptr)));
  for (int i = 0; names != nullptr && i < sk_GENERAL_NAME_num(names.get()); ++i) {
    const GENERAL_NAME* name = sk_GENERAL_NAME_value(names.get(), i);
    if (name->type != GEN_URI) continue;
    const ASN1_IA5STRING* uri = name->d.uniformResourceIdentifier;
    uris.emplace_back(reinterpret_cast<const char*>(ASN1_STRING_get0_data(uri)),
                      static_cast<size_t>(ASN1_STRING_length(uri)));
  }
  return uris;
}

absl::Status VerifyChain(const std::vector<Certificate>& roots,
                         const std::vector<Certificate>& chain) {
  const Store store(X509_STORE_new());
  for (const Certificate& root : roots) X509_STORE_add_cert(store.get(), root.get());
  const std::unique_ptr<STACK_OF(X509), FreeStack> untrusted(sk_X509_new_null());
  for (size_t i = 1; i < chain.size(); ++i) sk_X509_push(untrusted.get(), chain[i].get());
  const StoreContext context(X509_STORE_CTX_new());
  if (X509_STORE_CTX_init(context.get(), store.get(), chain[0].get(), untrusted.get()) != 1) {
    return absl::InternalError("libcrypto cannot start a verification");
  }
  if (X509_verify_cert(context.get()) == 1) return absl::OkStatus();
  const int error = X509_STORE_CTX_get_error(context.get());
  return absl::InvalidArgumentError(absl::StrCat("the certificate is not valid under `ca`: ",
                                                 X509_verify_cert_error_string(error)));
}

}  // namespace

absl::StatusOr<Leaf> ReadLeaf(absl::string_view pem) {
  const std::vector<Certificate> certificates = ReadCertificates(pem);
  if (certificates.empty()) return absl::InvalidArgumentError("there is no certificate in it");
  const X509* leaf = certificates.front().get();
  const std::vector<std::string> uris = UriNames(leaf);
  if (uris.size() != 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("the certificate has ", uris.size(), " URI names; it must have exactly one"));
  }
  RIPS_ASSIGN_OR_RETURN(PeerIdentity identity, ParseSpiffeUri(uris.front()));
  std::tm not_after{};
  if (ASN1_TIME_to_tm(X509_get0_notAfter(leaf), &not_after) != 1) {
    return absl::InvalidArgumentError("the certificate has no readable end of validity");
  }
  return Leaf{.identity = std::move(identity),
              .not_after = absl::FromTM(not_after, absl::UTCTimeZone())};
}

absl::Status CheckChain(absl::string_view ca_pem, absl::string_view cert_pem,
                        absl::string_view key_pem) {
  const std::vector<Certificate> roots = ReadCertificates(ca_pem);
  if (roots.empty()) return absl::InvalidArgumentError("there is no certificate in `ca`");
  const std::vector<Certificate> chain = ReadCertificates(cert_pem);
  if (chain.empty()) return absl::InvalidArgumentError("there is no certificate in `cert`");
  const Bio bio(BIO_new_mem_buf(key_pem.data(), static_cast<int>(key_pem.size())));
  const Key key(PEM_read_bio_PrivateKey(bio.get(), nullptr, NoPassword, nullptr));
  const bool fits = key != nullptr && X509_check_private_key(chain[0].get(), key.get()) == 1;
  ERR_clear_error();
  if (key == nullptr) {
    return absl::InvalidArgumentError("there is no unencrypted private key in `key`");
  }
  if (!fits) return absl::InvalidArgumentError("`key` does not belong to the certificate");
  return VerifyChain(roots, chain);
}

}  // namespace rips::rpc
