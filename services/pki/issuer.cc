#include "services/pki/issuer.h"

#include <openssl/bn.h>
#include <openssl/core_names.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/rand.h>
#include <openssl/x509.h>
#include <openssl/x509v3.h>

#include <algorithm>
#include <ctime>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/pki/openssl_request.h"
#include "services/rpc/openssl_types.h"

namespace rips::pki {

using rpc::openssl::Bio;
using rpc::openssl::Certificate;
using rpc::openssl::Freer;

struct CertificateRequest::Key {
  rpc::openssl::Key key;
};

struct Issuer::Authority {
  rpc::openssl::Key key;
  Certificate certificate;
  // All of `certificates_pem` that are certificates.
  std::string chain_pem;
};

namespace {

using Extension = std::unique_ptr<X509_EXTENSION, Freer<X509_EXTENSION_free>>;
using Extensions = std::unique_ptr<STACK_OF(X509_EXTENSION), decltype([](auto* all) {
                                     sk_X509_EXTENSION_pop_free(all, X509_EXTENSION_free);
                                   })>;

constexpr absl::string_view kBegin = "-----BEGIN CERTIFICATE REQUEST-----";
constexpr absl::string_view kEnd = "-----END CERTIFICATE REQUEST-----";
constexpr int kSerialBytes = 15;
constexpr int kRsaBitsMin = 3'072;
constexpr int kRsaBitsMax = 4'096;

absl::Status CheckKey(EVP_PKEY* key) {
  const int type = EVP_PKEY_get_base_id(key);
  const int bits = EVP_PKEY_get_bits(key);
  char encoding[32] = "";
  if (type == EVP_PKEY_EC &&
      EVP_PKEY_get_utf8_string_param(key, OSSL_PKEY_PARAM_EC_ENCODING, encoding, sizeof(encoding),
                                     nullptr) == 1 &&
      absl::string_view(encoding) != OSSL_PKEY_EC_ENCODING_GROUP) {
    return absl::InvalidArgumentError("its key has a curve without a name; make another");
  }
  if (type == EVP_PKEY_EC) {
    char group[64] = "";
    size_t size = 0;
    if (EVP_PKEY_get_group_name(key, group, sizeof(group), &size) == 1) {
      const absl::string_view name(group, size);
      if (name == "prime256v1" || name == "P-256" || name == "secp384r1" || name == "P-384") {
        return absl::OkStatus();
      }
    }
  }
  if (type == EVP_PKEY_RSA && bits >= kRsaBitsMin && bits <= kRsaBitsMax) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("its key is not P-256, P-384, or RSA of ",
                                                 kRsaBitsMin, " to ", kRsaBitsMax,
                                                 " bits; make another"));
}

absl::Status NoNames(X509_REQ* request) {
  if (X509_NAME_entry_count(X509_REQ_get_subject_name(request)) != 0) {
    return absl::InvalidArgumentError(
        "it asks for a subject; what a certificate says comes from the token or the certificate "
        "that is renewed: make the request without a subject");
  }
  const Extensions extensions(X509_REQ_get_extensions(request));
  if (extensions == nullptr || sk_X509_EXTENSION_num(extensions.get()) == 0) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError(
      "it asks for extensions, such as names; make the request without them");
}

bool AddExtension(X509* certificate, X509* issuer, int nid, const std::string& value) {
  X509V3_CTX context;
  X509V3_set_ctx_nodb(&context);
  X509V3_set_ctx(&context, issuer, certificate, nullptr, nullptr, 0);
  const Extension extension(X509V3_EXT_conf_nid(nullptr, &context, nid, value.c_str()));
  return extension != nullptr && X509_add_ext(certificate, extension.get(), -1) == 1;
}

bool SetSerial(X509* certificate) {
  unsigned char bytes[kSerialBytes];
  if (RAND_bytes(bytes, sizeof(bytes)) != 1) return false;
  bytes[0] |= 1;  // never 0
  const std::unique_ptr<BIGNUM, Freer<BN_free>> number(BN_bin2bn(bytes, sizeof(bytes), nullptr));
  return number != nullptr &&
         BN_to_ASN1_INTEGER(number.get(), X509_get_serialNumber(certificate)) != nullptr;
}

bool SetTime(ASN1_TIME* field, absl::Time time) {
  const std::time_t seconds = absl::ToTimeT(time);
  return ASN1_TIME_set(field, seconds) != nullptr;
}

bool Fill(X509* certificate, X509* issuer, EVP_PKEY* key, const rpc::PeerIdentity& identity,
          absl::Time begin, absl::Time end) {
  const std::string name = absl::StrCat("RIPS ", rpc::RoleName(identity.role));
  return X509_set_version(certificate, X509_VERSION_3) == 1 && SetSerial(certificate) &&
         X509_NAME_add_entry_by_txt(X509_get_subject_name(certificate), "CN", MBSTRING_UTF8,
                                    reinterpret_cast<const unsigned char*>(name.c_str()), -1, -1,
                                    0) == 1 &&
         X509_set_issuer_name(certificate, X509_get_subject_name(issuer)) == 1 &&
         SetTime(X509_getm_notBefore(certificate), begin) &&
         SetTime(X509_getm_notAfter(certificate), end) && X509_set_pubkey(certificate, key) == 1 &&
         AddExtension(certificate, issuer, NID_basic_constraints, "critical,CA:FALSE") &&
         AddExtension(certificate, issuer, NID_key_usage, "critical,digitalSignature") &&
         AddExtension(certificate, issuer, NID_ext_key_usage, "clientAuth") &&
         AddExtension(certificate, issuer, NID_subject_key_identifier, "hash") &&
         AddExtension(certificate, issuer, NID_authority_key_identifier, "keyid") &&
         AddExtension(certificate, issuer, NID_subject_alt_name,
                      absl::StrCat("URI:", rpc::ToString(identity)));
}

// Whatever the time is.
bool ChainsTo(const std::vector<Certificate>& roots, const std::vector<Certificate>& chain) {
  const rpc::openssl::Store store(X509_STORE_new());
  for (const Certificate& root : roots) X509_STORE_add_cert(store.get(), root.get());
  const std::unique_ptr<STACK_OF(X509), rpc::openssl::FreeStack> between(sk_X509_new_null());
  for (size_t i = 1; i < chain.size(); ++i) sk_X509_push(between.get(), chain[i].get());
  const rpc::openssl::StoreContext context(X509_STORE_CTX_new());
  if (X509_STORE_CTX_init(context.get(), store.get(), chain[0].get(), between.get()) != 1) {
    return false;
  }
  X509_STORE_CTX_set_flags(context.get(), X509_V_FLAG_NO_CHECK_TIME);
  return X509_verify_cert(context.get()) == 1;
}

}  // namespace

absl::StatusOr<std::string> ToPem(X509* certificate) {
  const Bio out(BIO_new(BIO_s_mem()));
  char* data = nullptr;
  if (out == nullptr || PEM_write_bio_X509(out.get(), certificate) != 1) {
    return absl::InternalError("libcrypto cannot write a certificate");
  }
  const long size = BIO_get_mem_data(out.get(), &data);
  return std::string(data, static_cast<size_t>(size));
}

CertificateRequest::CertificateRequest(std::unique_ptr<Key> key, std::string key_hash)
    : key_(std::move(key)), key_hash_(std::move(key_hash)) {}
CertificateRequest::CertificateRequest(CertificateRequest&&) noexcept = default;
CertificateRequest& CertificateRequest::operator=(CertificateRequest&&) noexcept = default;
CertificateRequest::~CertificateRequest() = default;

absl::StatusOr<CertificateRequest> CertificateRequest::Read(absl::string_view pem) {
  if (pem.size() > kRequestBytesMax) {
    return absl::InvalidArgumentError(absl::StrCat("the request for a certificate has ", pem.size(),
                                                   " bytes, limit ", kRequestBytesMax));
  }
  // One block and nothing else: what stands beside it could be a key.
  const absl::string_view block = absl::StripAsciiWhitespace(pem);
  if (!absl::StartsWith(block, kBegin) || !absl::EndsWith(block, kEnd) ||
      block.find("-----BEGIN", 1) != block.npos) {
    return absl::InvalidArgumentError(
        "it is not one request for a certificate (PKCS#10, PEM) and nothing else");
  }
  const Bio bio(BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  const Request request(
      PEM_read_bio_X509_REQ(bio.get(), nullptr, rpc::openssl::NoPassword, nullptr));
  rpc::openssl::Key key(request == nullptr ? nullptr : X509_REQ_get_pubkey(request.get()));
  ERR_clear_error();
  if (key == nullptr) {
    return absl::InvalidArgumentError("there is no request for a certificate (PKCS#10, PEM) in it");
  }
  // Before the signature: to check one of a huge key takes long.
  RIPS_RETURN_IF_ERROR(CheckKey(key.get()));
  const bool proven = X509_REQ_verify(request.get(), key.get()) == 1;
  ERR_clear_error();
  if (!proven) return absl::InvalidArgumentError("its key has not signed the request");
  RIPS_RETURN_IF_ERROR(NoNames(request.get()));
  RIPS_ASSIGN_OR_RETURN(std::string hash, HashOf(key.get()));
  return CertificateRequest(std::make_unique<Key>(Key{std::move(key)}), std::move(hash));
}

Issuer::Issuer(std::unique_ptr<Authority> authority) : authority_(std::move(authority)) {}
Issuer::Issuer(Issuer&&) noexcept = default;
Issuer& Issuer::operator=(Issuer&&) noexcept = default;
Issuer::~Issuer() = default;

absl::StatusOr<Issuer> Issuer::Read(absl::string_view certificates_pem, absl::string_view key_pem,
                                    absl::string_view ca_pem) {
  std::vector<Certificate> chain = rpc::openssl::ReadCertificates(certificates_pem);
  if (chain.empty()) return absl::InvalidArgumentError("there is no certificate in `cert`");
  auto authority = std::make_unique<Authority>();
  absl::StatusOr<rpc::openssl::Key> key = ReadKey(key_pem);
  if (!key.ok()) return absl::InvalidArgumentError("there is no unencrypted key in `key`");
  authority->key = *std::move(key);
  const bool fits = X509_check_private_key(chain[0].get(), authority->key.get()) == 1;
  ERR_clear_error();
  if (!fits) return absl::InvalidArgumentError("`key` does not belong to the certificate");
  if (X509_check_ca(chain[0].get()) != 1 ||
      (X509_get_key_usage(chain[0].get()) & KU_KEY_CERT_SIGN) == 0) {
    return absl::InvalidArgumentError("the certificate in `cert` may not sign certificates");
  }
  const bool chained = ChainsTo(rpc::openssl::ReadCertificates(ca_pem), chain);
  ERR_clear_error();
  if (!chained) {
    return absl::InvalidArgumentError(
        "the certificate in `cert` is not issued under `tls.ca`: what it signs would not be "
        "trusted");
  }
  for (const Certificate& each : chain) {
    RIPS_ASSIGN_OR_RETURN(const std::string pem, ToPem(each.get()));
    authority->chain_pem += pem;
  }
  authority->certificate = std::move(chain[0]);
  return Issuer(std::move(authority));
}

absl::StatusOr<Issued> Issuer::Sign(const CertificateRequest& request,
                                    const rpc::PeerIdentity& identity, absl::Time now,
                                    absl::Duration life) const {
  X509* const issuer = authority_->certificate.get();
  RIPS_ASSIGN_OR_RETURN(const absl::Time from, rpc::openssl::ToTime(X509_get0_notBefore(issuer)));
  RIPS_ASSIGN_OR_RETURN(const absl::Time until, rpc::openssl::ToTime(X509_get0_notAfter(issuer)));
  if (now < from || now >= until) {
    return absl::FailedPreconditionError(absl::StrCat(
        "the issuing certificate is valid from ", absl::FormatTime(from, absl::UTCTimeZone()),
        " to ", absl::FormatTime(until, absl::UTCTimeZone()), "; renew it, or set the clock"));
  }
  const absl::Time end = std::min(now + life, until);
  const Certificate certificate(X509_new());
  EVP_PKEY* const key = request.key_->key.get();
  // An Ed25519 key signs without a digest of its own.
  const EVP_MD* digest =
      EVP_PKEY_get_base_id(authority_->key.get()) == EVP_PKEY_ED25519 ? nullptr : EVP_sha256();
  const bool signed_now =
      certificate != nullptr &&
      Fill(certificate.get(), issuer, key, identity, std::max(now - kBackdated, from), end) &&
      X509_sign(certificate.get(), authority_->key.get(), digest) > 0;
  ERR_clear_error();
  if (!signed_now) return absl::InternalError("libcrypto cannot sign a certificate");
  RIPS_ASSIGN_OR_RETURN(std::string pem, ToPem(certificate.get()));
  // As the certificate says it: in whole seconds.
  RIPS_ASSIGN_OR_RETURN(const absl::Time not_after,
                        rpc::openssl::ToTime(X509_get0_notAfter(certificate.get())));
  return Issued{.certificates_pem = absl::StrCat(pem, authority_->chain_pem),
                .serial = rpc::openssl::SerialText(X509_get0_serialNumber(certificate.get())),
                .not_after = not_after};
}

}  // namespace rips::pki
