// The stream to the policy server: rips.v1.ActuatorService.Attach seen as plain structs.
//
// Threads: BidiClient's session thread calls the callbacks, its writer thread writes. The Send
// functions may be called from any thread and never block.
#ifndef RIPS_MODE_ACTUATOR_LINK_DOWNLINK_H_
#define RIPS_MODE_ACTUATOR_LINK_DOWNLINK_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "mode_actuator/decide/level_controller.h"
#include "mode_actuator/decide/receipt.h"
#include "services/base/clock.h"
#include "services/base/config_setting.h"
#include "services/model/audit_head.h"
#include "services/model/command.h"
#include "services/ros2/guid.h"
#include "services/rpc/credentials.h"

namespace rips::actuator {

class Downlink {
 public:
  struct Options {
    std::vector<std::string> servers;
    rpc::CredentialsSource credentials;
    // See BidiClientOptions.
    std::function<void(const rpc::Peer&)> on_peer;
    // What does not change while the process lives, for ActuatorHello.
    std::string host;
    std::string incarnation;  // 16 random bytes
    std::vector<std::string> levels;
    std::string fail_safe_level;
    std::vector<std::string> programs;
    std::vector<std::string> protected_parts;
    std::vector<model::InactiveParts> inactive_parts;
    std::vector<std::string> published_while_inactive;
    ros2::Guid participant;               // none without DDS
    std::vector<ConfigSetting> settings;  // shown to operators
  };
  // All on the session thread, never two at once, not after Stop().
  struct Callbacks {
    // What to say hello with; a stream begins.
    std::function<ExecutorReport()> connected;
    std::function<model::AuditHead()> audit_head;
    std::function<void(model::Command)> command;
    std::function<void(model::LeaseGrant)> lease;
    std::function<void(const absl::Status&)> malformed;
    std::function<void(const absl::Status&)> disconnected;
  };

  // `clock` is not owned and outlives this.
  Downlink(Options options, Callbacks callbacks, const Clock* clock);
  ~Downlink();

  void Start();
  void Stop();

  // False if there is no stream, or its queue is full.
  bool SendReceipt(const Receipt& receipt);
  bool SendHeartbeat(const ExecutorReport& report,
                     const std::optional<model::FirewallDrops>& drops);
  bool connected() const;
  // How often the server wants a heartbeat on this stream.
  int64_t heartbeat_ns() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_LINK_DOWNLINK_H_
