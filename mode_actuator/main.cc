// rips-actuator: brings one robot host to the level the policy server decided, and keeps it safe
// when there is no server.
#include <cstdio>
#include <memory>
#include <optional>

#include "absl/status/status.h"
#include "absl/time/clock.h"
#include "mode_actuator/agent.h"
#include "services/dds/security.h"
#include "services/rpc/credentials.h"
#include "services/rpc/grpc_logs.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"
#include "services/runtime/shutdown.h"

namespace {

int Fail(int code, const absl::Status& status) {
  std::fprintf(stderr, "%s\n", std::string(status.message()).c_str());
  return code;
}

}  // namespace

int main(int argc, char** argv) {
  rips::rpc::RequireTls13();
  rips::rpc::RouteGrpcLogs();
  rips::DaemonFlags flags;
  const rips::DaemonInfo info = {.name = "rips-actuator",
                                 .description = "Applies alert levels to a ROS 2 robot.",
                                 .default_config = "/etc/rips/actuator.yaml"};
  if (std::optional<int> code = rips::ParseDaemonFlags(argc, argv, info, &flags)) return *code;
  rips::BlockSignals();

  const auto loaded = rips::actuator::LoadConfig(flags.config);
  if (!loaded.ok()) return Fail(rips::kExitConfig, loaded.status());
  if (const auto enclave = rips::dds::LoadSecurity(loaded->config.dds, absl::Now());
      !enclave.ok()) {
    return Fail(rips::kExitConfig, enclave.status());
  }
  if (flags.check_config) {
    std::printf("%s", loaded->effective.c_str());
    for (const std::string& warning : rips::actuator::Warnings(*loaded)) {
      std::fprintf(stderr, "warning: %s\n", warning.c_str());
    }
    return 0;
  }
  const auto credentials = rips::rpc::Credentials::Load(loaded->config.tls);
  if (!credentials.ok()) return Fail(rips::kExitConfig, credentials.status());

  const rips::RealClock clock;
  rips::Metrics metrics;
  rips::SignalWaiter signals({});
  const auto agent = rips::actuator::Agent::Start(*loaded, *credentials, &clock, &metrics);
  if (absl::IsPermissionDenied(agent.status())) return Fail(rips::kExitConfig, agent.status());
  if (!agent.ok()) return Fail(rips::kExitFailed, agent.status());
  const auto page = rips::MetricsServer::Start(loaded->config.metrics, &metrics,
                                               [&] { return (*agent)->Ready(); });
  if (!page.ok()) return Fail(rips::kExitFailed, page.status());
  rips::LogInfo("listening", {{"address", (*page)->address()}});
  if (const absl::Status ready = rips::WriteReadyFile(flags, "ready"); !ready.ok()) {
    return Fail(rips::kExitFailed, ready);
  }
  signals.WaitForShutdown();
  rips::LogInfo("stopping");
  return 0;
}
