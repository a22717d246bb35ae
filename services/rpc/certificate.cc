#include "services/rpc/certificate.h"

#include <openssl/bio.h>
#include <openssl/bn.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <openssl/x509v3.h>

#include <ctime>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "services/base/status_macros.h"
#include "services/rpc/openssl_types.h"

namespace rips::rpc {

using openssl::Bio;
using openssl::Certificate;
using openssl::Key;
using openssl::NoPassword;
using openssl::ReadCertificates;
using openssl::Store;
using openssl::StoreContext;

namespace openssl {

std::vector<Certificate> ReadCertificates(absl::string_view pem) {
  std::vector<Certificate> certificates;
  const Bio bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  while (X509* next = PEM_read_bio_X509(bio.get(), nullptr, NoPassword, nullptr)) {
    certificates.emplace_back(next);
  }
  ERR_clear_error();  // the end of the text counts as one
  return certificates;
}

std::string SerialText(const ASN1_INTEGER* serial) {
  const std::unique_ptr<BIGNUM, Freer<BN_free>> number(ASN1_INTEGER_to_BN(serial, nullptr));
  char* hex = number == nullptr ? nullptr : BN_bn2hex(number.get());
  if (hex == nullptr) return "";
  absl::string_view digits = hex;
  while (digits.size() > 1 && digits.front() == '0') digits.remove_prefix(1);
  std::string text = absl::AsciiStrToLower(digits);
  OPENSSL_free(hex);
  return text;
}

std::string NameText(const X509_NAME* name) {
  unsigned char* der = nullptr;
  const int size = i2d_X509_NAME(name, &der);
  if (size <= 0) return "";
  std::string text(reinterpret_cast<const char*>(der), static_cast<size_t>(size));
  OPENSSL_free(der);
  return text;
}

absl::StatusOr<absl::Time> ToTime(const ASN1_TIME* time) {
  std::tm fields{};
  if (time == nullptr || ASN1_TIME_to_tm(time, &fields) != 1) {
    return absl::InvalidArgumentError("it holds a time that cannot be read");
  }
  return absl::FromTM(fields, absl::UTCTimeZone());
}

}  // namespace openssl

namespace {

using Names = std::unique_ptr<GENERAL_NAMES, openssl::Freer<GENERAL_NAMES_free>>;

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

// Of a certificate that is refused for its times: which time, and the day that this host has, which
// may be the mistake. The same text all day, so that who waits says it once.
std::string TimesText(int error, const X509* certificate) {
  const bool early = error == X509_V_ERR_CERT_NOT_YET_VALID;
  if (certificate == nullptr || (!early && error != X509_V_ERR_CERT_HAS_EXPIRED)) return "";
  const auto time =
      openssl::ToTime(early ? X509_get0_notBefore(certificate) : X509_get0_notAfter(certificate));
  if (!time.ok()) return "";
  return absl::StrCat(early ? "; it is valid from " : "; it was valid until ",
                      absl::FormatTime("%Y-%m-%d %H:%M:%S UTC", *time, absl::UTCTimeZone()),
                      ", and the clock of this host says ",
                      absl::FormatTime("%Y-%m-%d", absl::Now(), absl::UTCTimeZone()));
}

absl::Status VerifyChain(const std::vector<Certificate>& roots,
                         const std::vector<Certificate>& chain) {
  const Store store(X509_STORE_new());
  for (const Certificate& root : roots) X509_STORE_add_cert(store.get(), root.get());
  const std::unique_ptr<STACK_OF(X509), openssl::FreeStack> untrusted(sk_X509_new_null());
  for (size_t i = 1; i < chain.size(); ++i) sk_X509_push(untrusted.get(), chain[i].get());
  const StoreContext context(X509_STORE_CTX_new());
  if (X509_STORE_CTX_init(context.get(), store.get(), chain[0].get(), untrusted.get()) != 1) {
    return absl::InternalError("libcrypto cannot start a verification");
  }
  if (X509_verify_cert(context.get()) == 1) return absl::OkStatus();
  const int error = X509_STORE_CTX_get_error(context.get());
  return absl::InvalidArgumentError(absl::StrCat(
      "the certificate is not valid under `ca`: ", X509_verify_cert_error_string(error),
      TimesText(error, X509_STORE_CTX_get_current_cert(context.get()))));
}

}  // namespace

absl::StatusOr<Peer> ReadLeaf(absl::string_view pem) {
  const std::vector<Certificate> certificates = ReadCertificates(pem);
  if (certificates.empty()) return absl::InvalidArgumentError("there is no certificate in it");
  const X509* leaf = certificates.front().get();
  const std::vector<std::string> uris = UriNames(leaf);
  if (uris.size() != 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("the certificate has ", uris.size(), " URI names; it must have exactly one"));
  }
  RIPS_ASSIGN_OR_RETURN(PeerIdentity identity, ParseSpiffeUri(uris.front()));
  RIPS_ASSIGN_OR_RETURN(const absl::Time not_before, openssl::ToTime(X509_get0_notBefore(leaf)));
  RIPS_ASSIGN_OR_RETURN(const absl::Time not_after, openssl::ToTime(X509_get0_notAfter(leaf)));
  return Peer{.identity = std::move(identity),
              .not_after = not_after,
              .not_before = not_before,
              .serial = openssl::SerialText(X509_get0_serialNumber(leaf))};
}

std::vector<CertificateId> ReadChain(absl::string_view pem) {
  std::vector<CertificateId> chain;
  for (const Certificate& each : ReadCertificates(pem)) {
    const X509_NAME* issuer = X509_get_issuer_name(each.get());
    if (X509_NAME_cmp(issuer, X509_get_subject_name(each.get())) == 0) continue;
    chain.push_back({.issuer = openssl::NameText(issuer),
                     .serial = openssl::SerialText(X509_get0_serialNumber(each.get()))});
  }
  return chain;
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
