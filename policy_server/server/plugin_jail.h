// How this server contains plugins and scanners, on the machine at hand.
//
//   server is   user of plugins             without it
//   root        `plugins.user`              named and missing: the server does not start
//               (default) rips-plugin       `nobody`, which is told
//   not root    the server's own            told; Landlock, seccomp and namespaces still hold
#ifndef RIPS_POLICY_SERVER_SERVER_PLUGIN_JAIL_H_
#define RIPS_POLICY_SERVER_SERVER_PLUGIN_JAIL_H_

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/policy/inspect/child_process.h"
#include "policy_server/server/config/config.h"
#include "services/runtime/run_cgroups.h"

namespace rips::server {

struct PluginJail {
  // Null: there are none that we may use.
  std::unique_ptr<RunCgroups> cgroups;
  // Valid as long as `cgroups`.
  inspect::Containment containment;
  // What cannot be enforced here, a line each.
  std::vector<std::string> missing;
};

// Kills what an earlier server with the same store left behind. InvalidArgument: no such user. A
// helper that cannot be executed is `missing`: it refuses the policies that need it, not the
// server.
absl::StatusOr<PluginJail> MakePluginJail(const ServerConfig& config);

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_PLUGIN_JAIL_H_
