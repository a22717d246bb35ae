// The mode actuator of one robot host, wired together.
#ifndef RIPS_MODE_ACTUATOR_LINK_AGENT_H_
#define RIPS_MODE_ACTUATOR_LINK_AGENT_H_

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "mode_actuator/config/config.h"
#include "mode_actuator/steps/system_mode/smh.h"
#include "services/base/clock.h"
#include "services/dds/host_addresses.h"
#include "services/rpc/certificate_monitor.h"
#include "services/rpc/credentials.h"
#include "services/runtime/metrics.h"

namespace rips::actuator {

// Inputs from the network waiting for the agent's thread; more are dropped and counted: the server
// sends a command again until it sees its receipt, and a lease every 500 ms.
inline constexpr size_t kNetworkInputsMax = 256;
// exec programs at the same time, those being started included.
inline constexpr size_t kExecsMax = 4;

// Reads and checks the file: configuration errors and SMH errors are InvalidArgument.
struct LoadedConfig {
  Config config;
  Smh smh;
  std::vector<ConfigSetting> settings;  // the effective configuration
};
absl::StatusOr<LoadedConfig> LoadConfig(const std::string& path);
// PermissionDenied: the certificate is not of the configuration's robot and host.
absl::Status CheckIdentity(const Config& config, const rpc::PeerIdentity& self);
// Warnings: legal there, but likely to be wrong.
std::vector<std::string> Warnings(const LoadedConfig& loaded);

class Agent {
 public:
  // Reads the state, joins the DDS domain, starts the threads and enters the level that the state
  // demands. `clock` and `metrics` are not owned and outlive this. The thread that keeps the level
  // calls `on_turn`, which may be null, several times a second while it does not hang.
  //
  // | what is missing now                    | what happens                                       |
  // |----------------------------------------|----------------------------------------------------|
  // | usable credentials                     | the same as without a server: the lease runs out,  |
  // |                                        | the floor comes; connects when they can be used    |
  // | the DDS keystore, or its network       | `modes_problem()`; steps of System Modes fail, the |
  // |                                        | others are taken. Start another when TryModes is OK|
  // | credentials of this robot's and host's | PermissionDenied, nothing was done                 |
  // | actuator: they are of another one      |                                                    |
  static absl::StatusOr<std::unique_ptr<Agent>> Start(const LoadedConfig& loaded,
                                                      rpc::CredentialsSource credentials,
                                                      const Clock* clock, Metrics* metrics,
                                                      rpc::CertificateMonitor* monitor = nullptr,
                                                      std::function<void()> on_turn = nullptr);
  // Ends the stream, the running job and programs. The robot stays where it is.
  ~Agent();

  // Why there is no way to the robot's System Modes; OK if there is, or none is needed.
  absl::Status modes_problem() const;
  // OK if there would be a way now.
  static absl::Status TryModes(const LoadedConfig& loaded, const Clock* clock);

  // What its DDS part sends from; empty without one.
  dds::InterfacesInUse interfaces() const;

  // OK if connected, the lease live and the effective level read back. Any thread.
  absl::Status Ready() const;
  // A line for `systemctl status`: level and problems. It may hold untrusted text. Any thread.
  std::string Describe() const;

 private:
  class Impl;
  explicit Agent(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_LINK_AGENT_H_
