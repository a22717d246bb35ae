// What anybody can hand to rips-enrol and to the server that issues certificates.
//
// The first byte picks: 0 = the text of a token, else a request for a certificate in DER, to which
// the PEM around it is added. What is accepted stays what it was when it is written and read again;
// no error quotes what it was given.
#include <cstddef>
#include <cstdint>
#include <string>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "services/base/check.h"
#include "services/enrol/token_text.h"
#include "services/pki/issuer.h"

namespace {

constexpr size_t kMessageBytesMax = 400;
constexpr size_t kPemColumns = 64;

void Token(absl::string_view text) {
  const auto token = rips::enrol::ParseToken(text);
  if (!token.ok()) {
    RIPS_CHECK(token.status().message().size() < kMessageBytesMax, "a long error");
    return;
  }
  const auto again = rips::enrol::ParseToken(rips::enrol::FormatToken(*token));
  RIPS_CHECK(again.ok() && again->robot() == token->robot() && again->host() == token->host(),
             "a token changes when it is written");
}

void Request(absl::string_view der) {
  std::string pem = "-----BEGIN CERTIFICATE REQUEST-----\n";
  const std::string base64 = absl::Base64Escape(der);
  for (size_t at = 0; at < base64.size(); at += kPemColumns) {
    absl::StrAppend(&pem, base64.substr(at, kPemColumns), "\n");
  }
  absl::StrAppend(&pem, "-----END CERTIFICATE REQUEST-----\n");
  const auto request = rips::pki::CertificateRequest::Read(pem);
  if (!request.ok()) {
    RIPS_CHECK(request.status().message().size() < kMessageBytesMax, "a long error");
    return;
  }
  RIPS_CHECK(request->key_hash() == rips::pki::CertificateRequest::Read(pem)->key_hash(),
             "the key of the same request changes");
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0) return 0;
  const absl::string_view rest(reinterpret_cast<const char*>(data + 1), size - 1);
  if (data[0] == 0) {
    Token(rest);
  } else {
    Request(rest);
  }
  return 0;
}
