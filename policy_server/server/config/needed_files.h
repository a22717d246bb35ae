// What must be on disk before the policy server starts, besides certificates, which it waits for.
#ifndef RIPS_POLICY_SERVER_SERVER_CONFIG_NEEDED_FILES_H_
#define RIPS_POLICY_SERVER_SERVER_CONFIG_NEEDED_FILES_H_

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/config/config.h"
#include "services/rpc/identity.h"

namespace rips::server {

// InvalidArgument with every directory of `config` that must exist and does not; or if the alert
// file is a link that the server cannot rotate. `file` is the name used in messages.
absl::Status CheckNeededDirectories(absl::string_view file, const ServerConfig& config);

// PermissionDenied: the certificate is not of the server that `config` names.
absl::Status CheckIdentity(const ServerConfig& config, const rpc::PeerIdentity& self);

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_CONFIG_NEEDED_FILES_H_
