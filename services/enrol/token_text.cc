#include "services/enrol/token_text.h"

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_sections.h"

namespace rips::enrol {
namespace {

constexpr int kRolesMax = 2;

absl::Status NotWhole() {
  return absl::InvalidArgumentError(
      "this is not a whole enrolment token: copy all of the line that `ripsctl enrol create-token` "
      "printed");
}

std::string WithoutSpaces(absl::string_view text) {
  std::string kept;
  for (const char c : text) {
    if (!absl::ascii_isspace(static_cast<unsigned char>(c))) kept += c;
  }
  return kept;
}

}  // namespace

std::string FormatToken(const v1::EnrolmentToken& token) {
  return absl::StrCat(kTokenPrefix, absl::WebSafeBase64Escape(token.SerializeAsString()));
}

absl::StatusOr<v1::EnrolmentToken> ParseToken(absl::string_view text) {
  if (text.size() > kTokenBytesMax) return NotWhole();
  const std::string line = WithoutSpaces(text);
  if (!absl::StartsWith(line, kTokenPrefix)) {
    if (!absl::StartsWith(line, "rips-token-")) return NotWhole();
    return absl::InvalidArgumentError(
        "the token is of another version of RIPS than this program; use the program of the "
        "server's "
        "version");
  }
  std::string bytes;
  v1::EnrolmentToken token;
  if (!absl::WebSafeBase64Unescape(line.substr(kTokenPrefix.size()), &bytes) ||
      !token.ParseFromString(bytes) || token.certificates_pem().empty() ||
      token.key_pem().empty() || token.authorities_pem().empty()) {
    return NotWhole();
  }
  RIPS_RETURN_IF_ERROR(ValidateName("token id", token.id()));
  RIPS_RETURN_IF_ERROR(ValidateName("robot id", token.robot()));
  RIPS_RETURN_IF_ERROR(ValidateName("host", token.host()));
  if (!IsHostPort(token.server())) {
    return absl::InvalidArgumentError("the token's server is not HOST:PORT");
  }
  if (token.roles().empty() || token.roles_size() > kRolesMax) return NotWhole();
  for (const std::string& role : token.roles()) {
    if (role != "sensor" && role != "actuator") {
      return absl::InvalidArgumentError("the token is for a role that is no agent's");
    }
  }
  return token;
}

}  // namespace rips::enrol
