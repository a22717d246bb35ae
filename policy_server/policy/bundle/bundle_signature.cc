#include "policy_server/policy/bundle/bundle_signature.h"

#include <openssl/bio.h>
#include <openssl/crypto.h>
#include <openssl/err.h>
#include <openssl/evp.h>
#include <openssl/pem.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <optional>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "policy_server/audit/format.h"
#include "policy_server/audit/signing_key.h"
#include "policy_server/policy/bundle/bundle_files.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"
#include "services/text/quote.h"

namespace rips::bundle {
namespace {

constexpr absl::string_view kAlgorithm = "ed25519 ";
constexpr size_t kKeyIdDigits = 16;
constexpr size_t kKeyNameBytesMax = 64;
constexpr absl::string_view kHowToSign = "`ripsctl rules sign DIR --key FILE`";

struct FreePem {
  void operator()(BIO* bio) const { BIO_free(bio); }
  void operator()(EVP_PKEY* key) const { EVP_PKEY_free(key); }
};
using PemKey = std::unique_ptr<EVP_PKEY, FreePem>;

enum class KeyHalf { kPublic, kPrivate };

PemKey ReadPem(absl::string_view pem, KeyHalf half) {
  const std::unique_ptr<BIO, FreePem> bio(
      BIO_new_mem_buf(pem.data(), static_cast<int>(pem.size())));
  if (bio == nullptr) return nullptr;
  // OpenSSL would ask for a password on the terminal.
  const auto no_password = [](char*, int, int, void*) { return -1; };
  PemKey key(half == KeyHalf::kPublic
                 ? PEM_read_bio_PUBKEY(bio.get(), nullptr, no_password, nullptr)
                 : PEM_read_bio_PrivateKey(bio.get(), nullptr, no_password, nullptr));
  // What OpenSSL leaves there would be taken for an error of the thread's next TLS call.
  ERR_clear_error();
  return key;
}

// InvalidArgument with what stands behind the key's name: "is encrypted; ...".
absl::StatusOr<PemKey> ReadEd25519(absl::string_view pem, KeyHalf half) {
  constexpr absl::string_view kMakeKey =
      "make one with `openssl genpkey -algorithm ed25519 -out FILE`";
  constexpr absl::string_view kMakePublic =
      "write the public one with `openssl pkey -in FILE -pubout -out NAME.pem`";
  const auto bad = [](absl::string_view what, absl::string_view remedy) {
    return absl::InvalidArgumentError(absl::StrCat(what, "; ", remedy));
  };
  const absl::string_view remedy = half == KeyHalf::kPublic ? kMakePublic : kMakeKey;
  const std::vector<absl::string_view> blocks = absl::StrSplit(pem, "-----BEGIN ");
  if (blocks.size() < 2) return bad("is not a key in PEM", remedy);
  if (blocks.size() > 2) return bad("has several PEM blocks", "leave one key in it");
  const bool is_private = absl::StrContains(pem, "PRIVATE KEY-----");
  if (half == KeyHalf::kPublic && is_private) return bad("is a private key", remedy);
  if (half == KeyHalf::kPrivate && !is_private) return bad("is not a private key", remedy);
  if (absl::StrContains(pem, "ENCRYPTED")) {
    return bad("is encrypted", "decrypt it with `openssl pkey -in FILE -out PLAIN`");
  }
  PemKey key = ReadPem(pem, half);
  if (key == nullptr) return bad("cannot be read as a key in PEM", remedy);
  if (EVP_PKEY_get_id(key.get()) != EVP_PKEY_ED25519) {
    const char* kind = EVP_PKEY_get0_type_name(key.get());
    return bad(
        absl::StrCat("is a key of kind ", kind == nullptr ? "(unknown)" : kind, ", not Ed25519"),
        kMakeKey);
  }
  return key;
}

std::string KeyIdOf(absl::string_view public_key) {
  return Sha256Hex(public_key).substr(0, kKeyIdDigits);
}

std::string ToSign(absl::string_view id) { return absl::StrCat("rips-bundle-signature 1\n", id); }

struct ParsedSignature {
  std::string key_id;
  std::string bytes;
};

// Only the one way of writing it.
std::optional<ParsedSignature> ParseSignature(absl::string_view text) {
  if (!absl::ConsumePrefix(&text, kAlgorithm) || !absl::ConsumeSuffix(&text, "\n")) return {};
  if (text.size() <= kKeyIdDigits || text[kKeyIdDigits] != ' ') return {};
  ParsedSignature parsed = {.key_id = std::string(text.substr(0, kKeyIdDigits))};
  if (parsed.key_id.find_first_not_of("0123456789abcdef") != std::string::npos) return {};
  const absl::string_view base64 = text.substr(kKeyIdDigits + 1);
  // Base64Unescape skips white space and takes what has no padding.
  if (!absl::Base64Unescape(base64, &parsed.bytes) ||
      parsed.bytes.size() != audit::kSignatureBytes || absl::Base64Escape(parsed.bytes) != base64) {
    return {};
  }
  return parsed;
}

bool IsKeyName(absl::string_view name) {
  return !name.empty() && name.size() <= kKeyNameBytesMax &&
         std::all_of(name.begin(), name.end(), [](char c) {
           return absl::ascii_isalnum(c) || c == '.' || c == '_' || c == '-';
         });
}

}  // namespace

absl::StatusOr<std::string> SignBundle(absl::string_view id, absl::string_view private_key_pem) {
  const absl::StatusOr<PemKey> pem = ReadEd25519(private_key_pem, KeyHalf::kPrivate);
  if (!pem.ok()) {
    return absl::InvalidArgumentError(absl::StrCat("the private key ", pem.status().message()));
  }
  std::string secret(audit::kPublicKeyBytes, '\0');
  size_t size = secret.size();
  if (EVP_PKEY_get_raw_private_key(pem->get(), reinterpret_cast<unsigned char*>(secret.data()),
                                   &size) != 1) {
    return absl::InternalError("reading an Ed25519 key failed in OpenSSL");
  }
  const absl::StatusOr<audit::SigningKey> key = audit::SigningKey::FromPrivate(secret);
  OPENSSL_cleanse(secret.data(), secret.size());
  RIPS_RETURN_IF_ERROR(key.status());
  RIPS_ASSIGN_OR_RETURN(const std::string signature, key->Sign(ToSign(id)));
  return absl::StrCat(kAlgorithm, KeyIdOf(key->public_key()), " ", absl::Base64Escape(signature),
                      "\n");
}

absl::StatusOr<std::string> ReadSignature(const std::string& dir) {
  RIPS_ASSIGN_OR_RETURN(const BundleDirectory directory, BundleDirectory::Open(dir));
  absl::StatusOr<std::string> text = directory.Read(kSignatureName, kSignatureBytesMax);
  if (absl::IsNotFound(text.status())) return std::string();
  return text;
}

absl::StatusOr<SignerKeys> SignerKeys::Load(const std::vector<std::string>& paths) {
  SignerKeys keys;
  for (const std::string& path : paths) RIPS_RETURN_IF_ERROR(keys.Add(path));
  return keys;
}

absl::Status SignerKeys::Add(const std::string& path) {
  const auto bad = [&](absl::string_view why) {
    return absl::InvalidArgumentError(absl::StrCat("public key ", QuoteBytes(path), " ", why));
  };
  std::string name = std::filesystem::path(path).filename().string();
  if (absl::EndsWith(name, ".pem")) name.resize(name.size() - 4);
  if (!IsKeyName(name)) {
    return bad(absl::StrCat("gives no name; name the file NAME.pem, where NAME is 1 to ",
                            kKeyNameBytesMax, " letters, digits, `.`, `_` and `-`"));
  }
  RIPS_ASSIGN_OR_RETURN(const std::string pem, ReadFile(path, kKeyFileBytesMax));
  if (pem.empty()) return bad("is empty");
  const absl::StatusOr<PemKey> key = ReadEd25519(pem, KeyHalf::kPublic);
  if (!key.ok()) return bad(key.status().message());
  std::string bytes(audit::kPublicKeyBytes, '\0');
  size_t size = bytes.size();
  if (EVP_PKEY_get_raw_public_key(key->get(), reinterpret_cast<unsigned char*>(bytes.data()),
                                  &size) != 1) {
    return bad("cannot be read as an Ed25519 key");
  }
  for (const auto& [id, other] : keys_) {
    if (other.name == name) return bad(absl::StrCat("has the name `", name, "` of another key"));
    if (other.public_key == bytes)
      return bad(absl::StrCat("is the same key as `", other.name, "`"));
  }
  std::string id = KeyIdOf(bytes);
  keys_.emplace(std::move(id), Key{.name = std::move(name), .public_key = std::move(bytes)});
  return absl::OkStatus();
}

absl::StatusOr<std::string> SignerKeys::Verify(absl::string_view id,
                                               absl::string_view signature) const {
  const auto denied = [&](absl::string_view why) {
    return absl::PermissionDeniedError(absl::StrCat("bundle ", QuoteBytes(id), " ", why));
  };
  if (signature.empty()) {
    return denied(absl::StrCat("has no signature; sign it with ", kHowToSign));
  }
  const std::optional<ParsedSignature> parsed = ParseSignature(signature);
  if (!parsed.has_value()) {
    return denied(absl::StrCat("has a malformed signature; sign it again with ", kHowToSign));
  }
  const auto found = keys_.find(parsed->key_id);
  if (found == keys_.end()) {
    return denied(absl::StrCat("is signed with the key ", parsed->key_id,
                               ", which is none of the server's `bundles: {keys: ...}`; sign it "
                               "with one of these, ",
                               kHowToSign, ", or add that key's public half to them"));
  }
  const Key& key = found->second;
  if (!audit::IsSignedBy(key.public_key, ToSign(id), parsed->bytes)) {
    ERR_clear_error();
    return denied(absl::StrCat("has a signature of the key `", key.name,
                               "` for other content; sign it again with ", kHowToSign));
  }
  return key.name;
}

}  // namespace rips::bundle
