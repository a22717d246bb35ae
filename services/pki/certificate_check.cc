#include "services/pki/certificate_check.h"

#include <openssl/err.h>
#include <openssl/x509.h>
#include <openssl/x509v3.h>

#include <algorithm>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/pki/openssl_request.h"
#include "services/rpc/openssl_types.h"
#include "services/text/quote.h"

namespace rips::pki {
namespace {

using IssuedNames = std::unique_ptr<GENERAL_NAMES, rpc::openssl::Freer<GENERAL_NAMES_free>>;
using IssuedUsages =
    std::unique_ptr<EXTENDED_KEY_USAGE, rpc::openssl::Freer<EXTENDED_KEY_USAGE_free>>;

constexpr absl::string_view kBeginCertificate = "-----BEGIN CERTIFICATE-----";
constexpr absl::string_view kEndCertificate = "-----END CERTIFICATE-----";
constexpr int kSerialBytesMax = 20;

std::string UtcSeconds(absl::Time time) {
  return absl::FormatTime("%Y-%m-%d %H:%M:%S UTC", time, absl::UTCTimeZone());
}

std::string TextOf(const ASN1_STRING* text) {
  return std::string(reinterpret_cast<const char*>(ASN1_STRING_get0_data(text)),
                     static_cast<size_t>(ASN1_STRING_length(text)));
}

// All certificates of a text that holds nothing else.
absl::StatusOr<std::vector<rpc::openssl::Certificate>> ReadOnlyCertificates(absl::string_view pem) {
  size_t blocks = 0;
  for (absl::string_view rest = absl::StripAsciiWhitespace(pem); !rest.empty(); ++blocks) {
    const size_t end = rest.find(kEndCertificate);
    if (!absl::StartsWith(rest, kBeginCertificate) || end == rest.npos ||
        rest.substr(0, end).find("-----BEGIN", 1) != rest.npos) {
      return absl::InvalidArgumentError("it is not certificates in PEM and nothing else");
    }
    rest = absl::StripAsciiWhitespace(rest.substr(end + kEndCertificate.size()));
  }
  if (blocks == 0) return absl::InvalidArgumentError("there is no certificate in it");
  if (blocks > kChainMax) {
    return absl::InvalidArgumentError(
        absl::StrCat("it has ", blocks, " certificates, limit ", kChainMax));
  }
  std::vector<rpc::openssl::Certificate> all = rpc::openssl::ReadCertificates(pem);
  if (all.size() == blocks) return all;
  return absl::InvalidArgumentError(
      absl::StrCat("certificate ", all.size() + 1, " of ", blocks, " in it cannot be decoded"));
}

absl::Status CheckKeyIsTheRequests(X509* leaf, const CertificateRequest& request) {
  const rpc::openssl::Key key(X509_get_pubkey(leaf));
  if (key != nullptr) {
    RIPS_ASSIGN_OR_RETURN(const std::string hash, HashOf(key.get()));
    if (hash == request.key_hash()) return absl::OkStatus();
  }
  return absl::InvalidArgumentError("its public key is not that of the request");
}

absl::Status CheckNames(X509* leaf, const rpc::PeerIdentity& identity) {
  const std::string uri = rpc::ToString(identity);
  // Null also if there are two such extensions.
  const IssuedNames names(
      static_cast<GENERAL_NAMES*>(X509_get_ext_d2i(leaf, NID_subject_alt_name, nullptr, nullptr)));
  const int count = names == nullptr ? 0 : sk_GENERAL_NAME_num(names.get());
  const std::string wanted =
      absl::StrCat("its subject alternative name must be URI:", uri, " and no other; it has ");
  if (count != 1) return absl::InvalidArgumentError(absl::StrCat(wanted, count, " names"));
  const GENERAL_NAME* name = sk_GENERAL_NAME_value(names.get(), 0);
  if (name->type != GEN_URI) {
    return absl::InvalidArgumentError(absl::StrCat(wanted, "one that is no URI"));
  }
  if (const std::string found = TextOf(name->d.uniformResourceIdentifier); found != uri) {
    return absl::InvalidArgumentError(absl::StrCat(wanted, Quote(found)));
  }
  X509_NAME* const subject = X509_get_subject_name(leaf);
  if (X509_NAME_entry_count(subject) == 0) return absl::OkStatus();
  const X509_NAME_ENTRY* entry = X509_NAME_get_entry(subject, 0);
  const std::string own = absl::StrCat("RIPS ", rpc::RoleName(identity.role));
  if (X509_NAME_entry_count(subject) == 1 &&
      OBJ_obj2nid(X509_NAME_ENTRY_get_object(entry)) == NID_commonName) {
    const std::string found = TextOf(X509_NAME_ENTRY_get_data(entry));
    if (found == own || found == uri) return absl::OkStatus();
  }
  return absl::InvalidArgumentError(
      absl::StrCat("its subject must be empty, CN=", own, " or CN=", uri));
}

absl::Status CheckUse(X509* leaf) {
  // Not X509_check_ca(), which takes CA:TRUE for nothing if the key usage has no keyCertSign.
  const uint32_t flags = X509_get_extension_flags(leaf);
  if ((flags & EXFLAG_INVALID) != 0 || X509_get_version(leaf) != X509_VERSION_3) {
    return absl::InvalidArgumentError("it is no valid certificate of X.509 version 3");
  }
  if ((flags & EXFLAG_CA) != 0) {
    return absl::InvalidArgumentError("it is the certificate of an authority (CA:TRUE)");
  }
  if (X509_get_key_usage(leaf) != KU_DIGITAL_SIGNATURE) {
    return absl::InvalidArgumentError("its key usage must be digitalSignature and nothing else");
  }
  const IssuedUsages usages(static_cast<EXTENDED_KEY_USAGE*>(
      X509_get_ext_d2i(leaf, NID_ext_key_usage, nullptr, nullptr)));
  if (usages == nullptr || sk_ASN1_OBJECT_num(usages.get()) != 1 ||
      OBJ_obj2nid(sk_ASN1_OBJECT_value(usages.get(), 0)) != NID_client_auth) {
    return absl::InvalidArgumentError("its extended key usage must be clientAuth and nothing else");
  }
  const ASN1_INTEGER* serial = X509_get0_serialNumber(leaf);
  if (ASN1_STRING_type(serial) != V_ASN1_INTEGER || ASN1_STRING_length(serial) > kSerialBytesMax ||
      rpc::openssl::SerialText(serial) == "0") {
    return absl::InvalidArgumentError("its serial number must be positive, of at most 20 bytes");
  }
  return absl::OkStatus();
}

struct Validity {
  absl::Time begin;
  absl::Time end;
};

absl::StatusOr<Validity> CheckTimes(X509* leaf, const CertificateOrder& order) {
  Validity valid;
  RIPS_ASSIGN_OR_RETURN(valid.begin, rpc::openssl::ToTime(X509_get0_notBefore(leaf)));
  RIPS_ASSIGN_OR_RETURN(valid.end, rpc::openssl::ToTime(X509_get0_notAfter(leaf)));
  const std::string is =
      absl::StrCat("; it is valid from ", UtcSeconds(valid.begin), " to ", UtcSeconds(valid.end),
                   ", and now is ", UtcSeconds(order.now));
  if (valid.begin > order.now + kBeginsLateMax) {
    return absl::InvalidArgumentError(absl::StrCat("it is not valid yet", is));
  }
  if (valid.end <= order.now) return absl::InvalidArgumentError(absl::StrCat("it has expired", is));
  if (valid.end - std::min(valid.begin, order.now) > order.life + kLongerMax) {
    return absl::InvalidArgumentError(absl::StrCat(
        "it is valid for too long: ", absl::FormatDuration(order.life), " were asked for, and ",
        absl::FormatDuration(kLongerMax), " more are accepted", is));
  }
  return valid;
}

// The certificates from the first one of `chain` up to a root of `ca_pem`, without the root; PEM.
absl::StatusOr<std::string> VerifiedChain(const std::vector<rpc::openssl::Certificate>& chain,
                                          absl::string_view ca_pem, absl::Time at) {
  const rpc::openssl::Store store(X509_STORE_new());
  for (const auto& root : rpc::openssl::ReadCertificates(ca_pem)) {
    X509_STORE_add_cert(store.get(), root.get());
  }
  const std::unique_ptr<STACK_OF(X509), rpc::openssl::FreeStack> between(sk_X509_new_null());
  for (size_t i = 1; i < chain.size(); ++i) sk_X509_push(between.get(), chain[i].get());
  const rpc::openssl::StoreContext context(X509_STORE_CTX_new());
  if (X509_STORE_CTX_init(context.get(), store.get(), chain[0].get(), between.get()) != 1) {
    return absl::InternalError("libcrypto cannot start a verification");
  }
  X509_STORE_CTX_set_purpose(context.get(), X509_PURPOSE_SSL_CLIENT);
  X509_STORE_CTX_set_time(context.get(), 0, absl::ToTimeT(at));
  if (X509_verify_cert(context.get()) != 1) {
    return absl::InvalidArgumentError(
        absl::StrCat("it does not lead to a root of `tls.ca`: ",
                     X509_verify_cert_error_string(X509_STORE_CTX_get_error(context.get()))));
  }
  STACK_OF(X509)* const verified = X509_STORE_CTX_get0_chain(context.get());
  std::string pem;
  for (int i = 0; i + 1 < sk_X509_num(verified); ++i) {
    RIPS_ASSIGN_OR_RETURN(const std::string each, ToPem(sk_X509_value(verified, i)));
    pem += each;
  }
  if (pem.empty()) return absl::InvalidArgumentError("it is a root of `tls.ca` itself");
  return pem;
}

absl::StatusOr<Issued> Check(absl::string_view certificates_pem, const CertificateOrder& order,
                             absl::string_view ca_pem) {
  RIPS_ASSIGN_OR_RETURN(const auto chain, ReadOnlyCertificates(certificates_pem));
  X509* const leaf = chain[0].get();
  RIPS_RETURN_IF_ERROR(CheckKeyIsTheRequests(leaf, *order.request));
  RIPS_RETURN_IF_ERROR(CheckNames(leaf, order.identity));
  RIPS_RETURN_IF_ERROR(CheckUse(leaf));
  RIPS_ASSIGN_OR_RETURN(const Validity valid, CheckTimes(leaf, order));
  RIPS_ASSIGN_OR_RETURN(std::string pem,
                        VerifiedChain(chain, ca_pem, std::max(order.now, valid.begin)));
  return Issued{.certificates_pem = std::move(pem),
                .serial = rpc::openssl::SerialText(X509_get0_serialNumber(leaf)),
                .not_after = valid.end};
}

}  // namespace

absl::StatusOr<Issued> CheckIssued(absl::string_view certificates_pem,
                                   const CertificateOrder& order, absl::string_view ca_pem) {
  absl::StatusOr<Issued> issued = Check(certificates_pem, order, ca_pem);
  ERR_clear_error();
  return issued;
}

}  // namespace rips::pki
