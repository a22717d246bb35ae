#include "policy_server/server/enrol/authority.h"

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/key_mode.h"
#include "services/runtime/log.h"

namespace rips::enrol {
namespace {

absl::Status OfEnrolment(absl::string_view why) {
  return absl::FailedPreconditionError(absl::StrCat("`enrolment` of the policy server: ", why));
}

absl::StatusOr<std::string> ReadPem(const std::string& path) {
  absl::StatusOr<std::string> text = ReadConfigFile(path);
  if (!text.ok()) return OfEnrolment(text.status().message());
  return text;
}

// Who reads it makes certificates for all robots and operators.
absl::Status CheckPrivate(const std::string& key, std::string* warning) {
  const absl::Status found = CheckKeyMode(key, warning);
  return found.ok() ? found : OfEnrolment(found.message());
}

absl::StatusOr<pki::Issuer> ReadIssuer(const IssuingFiles& files, const std::string& ca_pem) {
  std::string told_at_the_start;
  RIPS_RETURN_IF_ERROR(CheckPrivate(files.key, &told_at_the_start));
  RIPS_ASSIGN_OR_RETURN(const std::string cert, ReadPem(files.cert));
  RIPS_ASSIGN_OR_RETURN(const std::string key, ReadPem(files.key));
  absl::StatusOr<pki::Issuer> issuer = pki::Issuer::Read(cert, key, ca_pem);
  if (issuer.ok()) return issuer;
  return OfEnrolment(
      absl::StrCat(files.cert, " with ", files.key, ": ", issuer.status().message()));
}

}  // namespace

absl::Status CheckIssuingFiles(const IssuingFiles& files) {
  std::string warning;
  RIPS_RETURN_IF_ERROR(CheckPrivate(files.key, &warning));
  if (!warning.empty()) LogWarning(warning, {});
  return Authority::Read(files, nullptr).status();
}

absl::StatusOr<Authority> Authority::Read(const IssuingFiles& files, const ExternalCa* external) {
  RIPS_ASSIGN_OR_RETURN(std::string ca_pem, ReadPem(files.ca));
  std::optional<pki::Issuer> issuer;
  if (external == nullptr) {
    RIPS_ASSIGN_OR_RETURN(issuer, ReadIssuer(files, ca_pem));
  }
  return Authority(std::move(issuer), external, std::move(ca_pem));
}

absl::StatusOr<pki::Issued> Authority::Sign(const SigningOrder& order, absl::Time now) const {
  if (issuer_.has_value()) return issuer_->Sign(*order.request, order.identity, now, order.life);
  return external_->Sign(
      {.request = order.request, .identity = order.identity, .now = now, .life = order.life},
      order.request_pem, order.holder, ca_pem_);
}

}  // namespace rips::enrol
