// rips-sensor: reports what happens on one host's DDS domain to the policy server.
#include <optional>

#include "sensor_agent/daemon.h"
#include "services/rpc/credentials.h"
#include "services/runtime/core_dumps.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/shutdown.h"

int main(int argc, char** argv) {
  rips::OpenStandardStreams();
  rips::ForbidCoreDumps();
  rips::rpc::RequireTls13();
  rips::rpc::RouteGrpcLogs();
  rips::rpc::TrustGrpcLockOrder();
  rips::DaemonFlags flags;
  const std::optional<int> exit_code =
      rips::ParseDaemonFlags(argc, argv,
                             {.name = "rips-sensor",
                              .description = "Reports what happens on a DDS domain to the policy "
                                             "server.",
                              .default_config = "/etc/rips/sensor.yaml"},
                             &flags);
  if (exit_code.has_value()) return *exit_code;
  rips::BlockSignals();
  return rips::sensor::RunDaemon(flags);
}
