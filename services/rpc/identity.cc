#include "services/rpc/identity.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "services/base/ids.h"

namespace rips::rpc {
namespace {

constexpr size_t kTrustDomainBytesMax = 255;  // SPIFFE-ID §2.1
constexpr OperatorRole kOperatorRoles[] = {OperatorRole::kViewer, OperatorRole::kOperator,
                                           OperatorRole::kAdmin};

bool IsTrustDomain(absl::string_view text) {
  return !text.empty() && text.size() <= kTrustDomainBytesMax &&
         text.find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789._-") ==
             absl::string_view::npos;
}

// Fills the identity from the segments after the trust domain; false if they fit no form.
bool ParsePath(const std::vector<absl::string_view>& path, PeerIdentity* identity) {
  if (path.size() == 2 && path[0] == "policy-server") {
    identity->role = Role::kPolicyServer;
    identity->name = std::string(path[1]);
    return IsValidName(path[1]);
  }
  if (path.size() == 2 && path[0] == "enrolment") {
    identity->role = Role::kEnrolment;
    identity->name = std::string(path[1]);
    return IsValidName(path[1]);
  }
  if (path.size() == 4 && path[0] == "robot" && (path[2] == "sensor" || path[2] == "actuator")) {
    identity->role = path[2] == "sensor" ? Role::kSensor : Role::kActuator;
    identity->robot = std::string(path[1]);
    identity->host = std::string(path[3]);
    return IsValidName(path[1]) && IsValidName(path[3]);
  }
  if (path.size() == 3 && path[0] == "operator") {
    identity->role = Role::kOperator;
    identity->name = std::string(path[2]);
    for (const OperatorRole role : kOperatorRoles) {
      if (path[1] != OperatorRoleName(role)) continue;
      identity->operator_role = role;
      return IsValidName(path[2]);
    }
  }
  return false;
}

}  // namespace

absl::StatusOr<PeerIdentity> ParseSpiffeUri(absl::string_view uri) {
  if (uri.size() > kSpiffeUriBytesMax) {
    return absl::InvalidArgumentError(absl::StrCat(
        "certificate URI of ", uri.size(), " bytes exceeds the limit of ", kSpiffeUriBytesMax));
  }
  PeerIdentity identity;
  absl::string_view rest = uri;
  const bool has_scheme = absl::ConsumePrefix(&rest, "spiffe://");
  std::vector<absl::string_view> path = absl::StrSplit(rest, '/');
  identity.trust_domain = std::string(path[0]);
  path.erase(path.begin());
  if (!has_scheme || !IsTrustDomain(identity.trust_domain) || !ParsePath(path, &identity)) {
    return absl::InvalidArgumentError(
        absl::StrCat("certificate URI `", uri,
                     "` names no policy server, sensor, actuator or operator; mint it anew"));
  }
  return identity;
}

std::string ToString(const PeerIdentity& identity) {
  const std::string domain = absl::StrCat("spiffe://", identity.trust_domain);
  switch (identity.role) {
    case Role::kPolicyServer:
      return absl::StrCat(domain, "/policy-server/", identity.name);
    case Role::kSensor:
    case Role::kActuator:
      return absl::StrCat(domain, "/robot/", identity.robot, "/", RoleName(identity.role), "/",
                          identity.host);
    case Role::kOperator:
      return absl::StrCat(domain, "/operator/", OperatorRoleName(identity.operator_role), "/",
                          identity.name);
    case Role::kEnrolment:
      return absl::StrCat(domain, "/enrolment/", identity.name);
  }
  return domain;
}

absl::string_view RoleName(Role role) {
  switch (role) {
    case Role::kPolicyServer:
      return "policy-server";
    case Role::kSensor:
      return "sensor";
    case Role::kActuator:
      return "actuator";
    case Role::kOperator:
      return "operator";
    case Role::kEnrolment:
      return "enrolment";
  }
  return "";
}

absl::string_view OperatorRoleName(OperatorRole role) {
  switch (role) {
    case OperatorRole::kViewer:
      return "viewer";
    case OperatorRole::kOperator:
      return "operator";
    case OperatorRole::kAdmin:
      return "admin";
  }
  return "";
}

}  // namespace rips::rpc
