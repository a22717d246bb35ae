#include "services/dds/security.h"

#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/pkcs7.h>
#include <openssl/sha.h>
#include <openssl/x509.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/atomic_file.h"

namespace rips::dds {
namespace {

template <auto Free>
struct Freed {
  template <typename T>
  void operator()(T* owned) const {
    Free(owned);
  }
};
using OwnedBio = std::unique_ptr<BIO, Freed<BIO_free_all>>;
using OwnedCertificate = std::unique_ptr<X509, Freed<X509_free>>;
using OwnedKey = std::unique_ptr<EVP_PKEY, Freed<EVP_PKEY_free>>;
using OwnedCrl = std::unique_ptr<X509_CRL, Freed<X509_CRL_free>>;
using OwnedStore = std::unique_ptr<X509_STORE, Freed<X509_STORE_free>>;
using OwnedStoreContext = std::unique_ptr<X509_STORE_CTX, Freed<X509_STORE_CTX_free>>;
using OwnedSigned = std::unique_ptr<PKCS7, Freed<PKCS7_free>>;

absl::Status Bad(const std::string& path, absl::string_view what) {
  ERR_clear_error();
  return absl::InvalidArgumentError(absl::StrCat("`", path, "` ", what));
}

OwnedBio Memory(const std::string& text) {
  return OwnedBio(BIO_new_mem_buf(text.data(), static_cast<int>(text.size())));
}

absl::StatusOr<std::string> Read(const std::string& path) {
  absl::StatusOr<std::string> text = ReadFile(path, kSecurityFileBytesMax);
  if (text.ok()) return text;
  return absl::Status(text.status().code(),
                      absl::StrCat("DDS security: ", text.status().message()));
}

absl::StatusOr<OwnedCertificate> ReadCertificate(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, Read(path));
  OwnedCertificate certificate(PEM_read_bio_X509(Memory(text).get(), nullptr, nullptr, nullptr));
  if (certificate == nullptr) return Bad(path, "is no certificate in PEM");
  return certificate;
}

// Never prompts for a passphrase.
int NoPassphrase(char*, int, int, void*) { return 0; }

absl::StatusOr<OwnedKey> ReadKey(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, Read(path));
  OwnedKey key(PEM_read_bio_PrivateKey(Memory(text).get(), nullptr, NoPassphrase, nullptr));
  if (key == nullptr) return Bad(path, "is no private key in PEM without passphrase");
  return key;
}

// The one common name of its subject.
std::string CommonName(X509* certificate) {
  char name[256] = {};
  X509_NAME_get_text_by_NID(X509_get_subject_name(certificate), NID_commonName, name, sizeof(name));
  return name;
}

// Does not look at times: those have messages of their own.
absl::Status CheckIssuer(X509* certificate, const std::string& path, X509* authority,
                         const std::string& authority_path, X509_CRL* crl) {
  const OwnedStore store(X509_STORE_new());
  X509_STORE_add_cert(store.get(), authority);
  uint64_t flags = X509_V_FLAG_NO_CHECK_TIME | X509_V_FLAG_PARTIAL_CHAIN;
  if (crl != nullptr) {
    X509_STORE_add_crl(store.get(), crl);
    flags |= X509_V_FLAG_CRL_CHECK;
  }
  X509_STORE_set_flags(store.get(), flags);
  const OwnedStoreContext context(X509_STORE_CTX_new());
  X509_STORE_CTX_init(context.get(), store.get(), certificate, nullptr);
  if (X509_verify_cert(context.get()) == 1) return absl::OkStatus();
  const int error = X509_STORE_CTX_get_error(context.get());
  return Bad(path, absl::StrCat("is not vouched for by `", authority_path,
                                "`: ", X509_verify_cert_error_string(error)));
}

absl::Status CheckTimes(X509* certificate, const std::string& path, absl::Time now) {
  time_t at = absl::ToTimeT(now);
  const auto expired = [&](absl::string_view how) {
    return absl::FailedPreconditionError(absl::StrCat("`", path, "` ", how, "; mint a new one"));
  };
  if (X509_cmp_time(X509_get0_notBefore(certificate), &at) > 0) return expired("is not valid yet");
  if (X509_cmp_time(X509_get0_notAfter(certificate), &at) < 0) return expired("has expired");
  return absl::OkStatus();
}

// The text that was signed (DDS Security 1.1 §9.4.1: S/MIME, text in clear).
absl::StatusOr<std::string> ReadSigned(const std::string& path, X509* authority,
                                       const std::string& authority_path) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, Read(path));
  BIO* content = nullptr;
  const OwnedSigned pkcs7(SMIME_read_PKCS7(Memory(text).get(), &content));
  const OwnedBio owned_content(content);
  if (pkcs7 == nullptr || content == nullptr) return Bad(path, "is no signed document (S/MIME)");
  struct FreeStack {
    void operator()(STACK_OF(X509) * stack) const { sk_X509_free(stack); }
  };
  const std::unique_ptr<STACK_OF(X509), FreeStack> signers(sk_X509_new_null());
  sk_X509_push(signers.get(), authority);
  const OwnedBio out(BIO_new(BIO_s_mem()));
  // The authority itself must have signed: no chain to verify.
  if (PKCS7_verify(pkcs7.get(), signers.get(), nullptr, content, out.get(),
                   PKCS7_TEXT | PKCS7_NOINTERN | PKCS7_NOVERIFY) != 1) {
    return Bad(path, absl::StrCat("is not signed by `", authority_path, "`"));
  }
  char* data = nullptr;
  const long size = BIO_get_mem_data(out.get(), &data);  // NOLINT: as OpenSSL declares it
  return std::string(data, static_cast<size_t>(std::max(size, 0L)));
}

// What stands between <tag> and </tag>, from `*pos` on, without blanks around; nullopt if there is
// no more. `*pos` goes behind it. Enough for documents whose signature has been checked.
std::optional<absl::string_view> Element(absl::string_view xml, absl::string_view tag,
                                         size_t* pos) {
  const std::string open = absl::StrCat("<", tag, ">");
  const size_t begin = xml.find(open, *pos);
  if (begin == absl::string_view::npos) return std::nullopt;
  const size_t end = xml.find(absl::StrCat("</", tag, ">"), begin);
  if (end == absl::string_view::npos) return std::nullopt;
  *pos = end;
  return absl::StripAsciiWhitespace(xml.substr(begin + open.size(), end - begin - open.size()));
}

std::string WithoutComments(absl::string_view xml) {
  std::string kept;
  while (true) {
    const size_t begin = xml.find("<!--");
    absl::StrAppend(&kept, xml.substr(0, begin));
    if (begin == absl::string_view::npos) return kept;
    const size_t end = xml.find("-->", begin);
    if (end == absl::string_view::npos) return kept;
    xml.remove_prefix(end + 3);
  }
}

// XML Schema dateTime, in UTC unless it says otherwise.
std::optional<absl::Time> ParseDateTime(absl::string_view text) {
  absl::Time time;
  std::string error;
  for (const char* format : {"%Y-%m-%dT%H:%M:%E*S%Ez", "%Y-%m-%dT%H:%M:%E*S"}) {
    if (absl::ParseTime(format, text, &time, &error)) return time;
  }
  return std::nullopt;
}

// The grant of `name` is there, and holds at `now`. The middleware reads the rest. Returns a topic
// that it allows.
absl::StatusOr<std::string> CheckPermissions(const std::string& path, absl::string_view signed_xml,
                                             const std::string& name, absl::Time now) {
  const std::string xml = WithoutComments(signed_xml);
  const std::string subject = absl::StrCat("CN=", name);
  size_t pos = 0;
  std::vector<std::string> others;
  while (const std::optional<absl::string_view> found = Element(xml, "subject_name", &pos)) {
    if (*found != subject) {
      others.push_back(ros2::Printable(*found));
      continue;
    }
    const auto from = Element(xml, "not_before", &pos);
    const auto to = Element(xml, "not_after", &pos);
    const auto begins = from ? ParseDateTime(*from) : std::nullopt;
    const auto ends = to ? ParseDateTime(*to) : std::nullopt;
    if (!begins || !ends) return Bad(path, "does not say from when to when it holds");
    if (now < *begins || now > *ends) {
      return absl::FailedPreconditionError(absl::StrCat("`", path, "` holds from ",
                                                        absl::FormatTime(*begins), " to ",
                                                        absl::FormatTime(*ends), " only"));
    }
    std::optional<absl::string_view> topic;
    if (Element(xml, "allow_rule", &pos)) {
      pos = xml.rfind("<allow_rule>", pos);
      topic = Element(xml, "topic", &pos);
    }
    if (!topic) return Bad(path, absl::StrCat("allows `", subject, "` no topic"));
    return absl::StrReplaceAll(*topic, {{"*", "rips_probe"}, {"?", "x"}});
  }
  return Bad(path, absl::StrCat("grants `", subject, "` nothing",
                                others.empty() ? "" : absl::StrCat(", but `", others[0], "`")));
}

bool IsEnclaveName(absl::string_view name) {
  if (name.size() > ros2::kRosNameBytesMax || !absl::StartsWith(name, "/")) return false;
  for (const absl::string_view part : absl::StrSplit(name.substr(1), '/')) {
    const bool plain = !part.empty() && std::all_of(part.begin(), part.end(), [](char c) {
      return absl::ascii_isalnum(c) || c == '_' || c == '-';
    });
    if (!plain) return false;
  }
  return true;
}

absl::Status Check(Enclave& enclave, absl::Time now) {
  RIPS_ASSIGN_OR_RETURN(const OwnedCertificate identity_ca, ReadCertificate(enclave.identity_ca));
  RIPS_ASSIGN_OR_RETURN(const OwnedCertificate permissions_ca,
                        ReadCertificate(enclave.permissions_ca));
  RIPS_ASSIGN_OR_RETURN(const OwnedCertificate certificate, ReadCertificate(enclave.certificate));
  RIPS_ASSIGN_OR_RETURN(const OwnedKey key, ReadKey(enclave.private_key));
  OwnedCrl crl;
  const absl::StatusOr<std::string> crl_text = ReadFile(enclave.crl, kSecurityFileBytesMax);
  if (absl::IsNotFound(crl_text.status())) {
    enclave.crl.clear();
  } else {
    RIPS_RETURN_IF_ERROR(crl_text.status());
    crl.reset(PEM_read_bio_X509_CRL(Memory(*crl_text).get(), nullptr, nullptr, nullptr));
    if (crl == nullptr) return Bad(enclave.crl, "is no list of revoked certificates in PEM");
  }
  if (X509_check_private_key(certificate.get(), key.get()) != 1) {
    return Bad(enclave.private_key, absl::StrCat("is not the key of `", enclave.certificate, "`"));
  }
  RIPS_RETURN_IF_ERROR(CheckIssuer(certificate.get(), enclave.certificate, identity_ca.get(),
                                   enclave.identity_ca, crl.get()));
  RIPS_RETURN_IF_ERROR(CheckTimes(identity_ca.get(), enclave.identity_ca, now));
  RIPS_RETURN_IF_ERROR(CheckTimes(certificate.get(), enclave.certificate, now));
  RIPS_ASSIGN_OR_RETURN(
      const std::string governance,
      ReadSigned(enclave.governance, permissions_ca.get(), enclave.permissions_ca));
  RIPS_ASSIGN_OR_RETURN(
      const std::string permissions,
      ReadSigned(enclave.permissions, permissions_ca.get(), enclave.permissions_ca));
  RIPS_ASSIGN_OR_RETURN(
      enclave.permitted_topic,
      CheckPermissions(enclave.permissions, permissions, CommonName(certificate.get()), now));
  size_t pos = 0;
  const std::string rules = WithoutComments(governance);
  // One domain rule that admits them is enough to doubt.
  while (const auto admits = Element(rules, "allow_unauthenticated_participants", &pos)) {
    enclave.admits_unauthenticated |= absl::EqualsIgnoreCase(*admits, "true") || *admits == "1";
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<Enclave> LoadEnclave(absl::string_view keystore, absl::string_view enclave,
                                    absl::Time now) {
  if (!absl::StartsWith(keystore, "/")) {
    return absl::InvalidArgumentError(
        absl::StrCat("keystore `", ros2::Printable(keystore), "` is no absolute path"));
  }
  if (!IsEnclaveName(enclave)) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", ros2::Printable(enclave), "` is no enclave, such as `/rips/sensor`"));
  }
  const std::string folder = absl::StrCat(keystore, "/enclaves", enclave, "/");
  Enclave loaded{.name = std::string(enclave),
                 .identity_ca = absl::StrCat(folder, "identity_ca.cert.pem"),
                 .certificate = absl::StrCat(folder, "cert.pem"),
                 .private_key = absl::StrCat(folder, "key.pem"),
                 .permissions_ca = absl::StrCat(folder, "permissions_ca.cert.pem"),
                 .governance = absl::StrCat(folder, "governance.p7s"),
                 .permissions = absl::StrCat(folder, "permissions.p7s"),
                 .crl = absl::StrCat(folder, "crl.pem")};
  RIPS_RETURN_IF_ERROR(Check(loaded, now));
  return loaded;
}

bool ProvesEnclave(const ros2::Guid& participant, absl::string_view enclave) {
  // A longer common name is none (RFC 5280, ub-common-name).
  constexpr size_t kNameBytesMax = 64;
  if (enclave.empty() || enclave.size() > kNameBytesMax) return false;
  const auto wrap = [](char tag, absl::string_view content) {
    return absl::StrCat(absl::string_view(&tag, 1),
                        std::string(1, static_cast<char>(content.size())), content);
  };
  // Name ::= SEQUENCE { SET { SEQUENCE { commonName, UTF8String } } }
  const absl::string_view common_name("\x06\x03\x55\x04\x03", 5);
  const std::string subject =
      wrap(0x30, wrap(0x31, wrap(0x30, absl::StrCat(common_name, wrap(0x0c, enclave)))));
  uint8_t hash[SHA256_DIGEST_LENGTH];
  SHA256(reinterpret_cast<const uint8_t*>(subject.data()), subject.size(), hash);
  if (participant.bytes[0] != (0x80 | hash[0] >> 1)) return false;
  for (size_t i = 1; i < 6; ++i) {
    const uint8_t shifted = static_cast<uint8_t>((hash[i - 1] & 1) << 7 | hash[i] >> 1);
    if (participant.bytes[i] != shifted) return false;
  }
  return true;
}

absl::StatusOr<std::optional<Enclave>> LoadSecurity(const DdsSettings& settings, absl::Time now) {
  if (settings.keystore.empty()) return std::nullopt;
  RIPS_ASSIGN_OR_RETURN(Enclave enclave, LoadEnclave(settings.keystore, settings.enclave, now));
  return enclave;
}

}  // namespace rips::dds
