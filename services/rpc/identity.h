// Who a certificate says its holder is.
#ifndef RIPS_SERVICES_RPC_IDENTITY_H_
#define RIPS_SERVICES_RPC_IDENTITY_H_

#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::rpc {

enum class Role { kPolicyServer, kSensor, kActuator, kOperator, kEnrolment };

// In ascending order of power; each may do what the ones before it may.
enum class OperatorRole { kViewer, kOperator, kAdmin };

// | role          | URI                                                   | fields set          |
// |---------------|-------------------------------------------------------|---------------------|
// | kPolicyServer | spiffe://<td>/policy-server/<name>                    | name                |
// | kSensor       | spiffe://<td>/robot/<robot>/sensor/<host>             | robot, host         |
// | kActuator     | spiffe://<td>/robot/<robot>/actuator/<host>           | robot, host         |
// | kOperator     | spiffe://<td>/operator/<viewer|operator|admin>/<name> | operator_role, name |
// | kEnrolment    | spiffe://<td>/enrolment/<token>                       | name                |
struct PeerIdentity {
  Role role = Role::kSensor;
  std::string trust_domain;
  std::string robot;
  std::string host;
  OperatorRole operator_role = OperatorRole::kViewer;
  std::string name;  // id of the server, name of the operator, id of the token

  friend bool operator==(const PeerIdentity&, const PeerIdentity&) = default;
};

inline constexpr size_t kSpiffeUriBytesMax = 2048;  // SPIFFE-ID §2.3

// InvalidArgument for anything but one of the forms above: trust domain of [a-z0-9._-], 1 to 255
// bytes; names as in IsValidName; no query, fragment, port, user, escapes, empty or extra segments.
absl::StatusOr<PeerIdentity> ParseSpiffeUri(absl::string_view uri);

// The URI; ParseSpiffeUri(ToString(i)) == i for every identity that came from it.
std::string ToString(const PeerIdentity& identity);

// `policy-server`, `sensor`, `actuator`, `operator`, `enrolment`.
absl::string_view RoleName(Role role);
// `viewer`, `operator`, `admin`.
absl::string_view OperatorRoleName(OperatorRole role);

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_IDENTITY_H_
