#include "mode_actuator/link/downlink.h"

#include <atomic>
#include <utility>

#include "rips/v1/actuator.grpc.pb.h"
#include "services/model/heartbeat.h"
#include "services/model_proto/actuator_codec.h"
#include "services/model_proto/configuration_codec.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/daemon_flags.h"
#include "services/wire_limits/field_limits.h"

namespace rips::actuator {
namespace {

using Client = rpc::BidiClient<v1::ActuatorMessage, v1::ActuatorReply>;

// What robots, programs and devices said may be too long for the server, which would end the
// stream; here it is cut.
v1::ActuatorMessage WithinLimits(v1::ActuatorMessage message) {
  wire_limits::CutToLimits(message);
  return message;
}

}  // namespace

class Downlink::Impl {
 public:
  Impl(Options options, Callbacks callbacks, const Clock* clock)
      : options_(std::move(options)), callbacks_(std::move(callbacks)), clock_(clock) {
    rpc::BidiClientOptions rpc_options;
    rpc_options.servers = options_.servers;
    rpc_options.credentials = options_.credentials;
    rpc_options.on_peer = options_.on_peer;
    rpc_options.backoff = rpc::ActuatorBackoff();
    Client::Callbacks rpc_callbacks;
    rpc_callbacks.start_stream = [](const auto& channel, auto* context) {
      return v1::ActuatorService::NewStub(channel)->Attach(context);
    };
    rpc_callbacks.on_connected = [this] { return WithinLimits(MakeHello()); };
    rpc_callbacks.on_message = [this](v1::ActuatorReply reply) { OnReply(reply); };
    rpc_callbacks.on_disconnected = [this](const grpc::Status& status, rpc::CloseClass) {
      callbacks_.disconnected(rpc::FromGrpc(status));
    };
    client_ = std::make_unique<Client>(std::move(rpc_options), std::move(rpc_callbacks));
  }

  Client& client() { return *client_; }
  int64_t heartbeat_ns() const { return heartbeat_ns_; }

  v1::ActuatorMessage MakeHeartbeat(const ExecutorReport& report,
                                    const std::optional<model::FirewallDrops>& drops) const {
    const Instant now = clock_->Now();
    v1::ActuatorMessage message;
    *message.mutable_heartbeat() =
        model_proto::Encode(model::ActuatorHeartbeat{.boottime_ns = now.boottime_ns,
                                                     .effective_level = report.effective,
                                                     .observed = report.observed,
                                                     .verified = report.verified,
                                                     .floor_reason = report.floor_reason,
                                                     .degraded = report.degraded,
                                                     .drifts = report.drifts,
                                                     .firewall_drops = drops});
    v1::Heartbeat* heartbeat = message.mutable_heartbeat()->mutable_heartbeat();
    heartbeat->mutable_clock()->set_unix_ns(now.unix_ns);
    heartbeat->set_echo_boottime_ns(newest_boottime_ns_);
    return message;
  }

 private:
  v1::ActuatorMessage MakeHello() {
    newest_boottime_ns_ = 0;
    heartbeat_ns_ = model::kHeartbeatNs;
    const ExecutorReport report = callbacks_.connected();
    v1::ActuatorMessage message;
    *message.mutable_hello() = model_proto::Encode(
        model::ActuatorHello{.levels = options_.levels,
                             .programs = options_.programs,
                             .decision_id = report.decision_id,
                             .decided_level = report.decided,
                             .effective_level = report.effective,
                             .highest_term = report.highest_term,
                             .state_lost = report.state_lost,
                             .fail_safe_level = options_.fail_safe_level,
                             .participant = options_.participant,
                             .protected_parts = options_.protected_parts,
                             .inactive_parts = options_.inactive_parts,
                             .published_while_inactive = options_.published_while_inactive,
                             .last_audit_head = callbacks_.audit_head(),
                             .clock = clock_->Now()});
    v1::Hello* hello = message.mutable_hello()->mutable_hello();
    hello->set_version(std::string(RipsVersion()));
    hello->set_incarnation(options_.incarnation);
    hello->set_host(options_.host);
    *hello->mutable_configuration() = model_proto::Encode(options_.settings);
    return message;
  }

  void OnReply(const v1::ActuatorReply& reply) {
    if (reply.has_lease()) {
      const uint64_t boottime_ns = reply.lease().heartbeat().clock().boottime_ns();
      if (boottime_ns > newest_boottime_ns_) newest_boottime_ns_ = boottime_ns;
      heartbeat_ns_ = model::HeartbeatIntervalNs(reply.lease().heartbeat_ms());
      callbacks_.lease(model_proto::Decode(reply.lease()));
    } else if (reply.has_command()) {
      absl::StatusOr<model::Command> command = model_proto::Decode(reply.command());
      if (command.ok()) {
        callbacks_.command(*std::move(command));
      } else {
        callbacks_.malformed(command.status());
      }
    }
    // Anything else is of a later protocol, and ignored.
  }

  const Options options_;
  const Callbacks callbacks_;
  const Clock* const clock_;                      // Not owned; outlives this.
  std::atomic<uint64_t> newest_boottime_ns_ = 0;  // the server's, of this stream
  std::atomic<int64_t> heartbeat_ns_ = model::kHeartbeatNs;
  std::unique_ptr<Client> client_;
};

Downlink::Downlink(Options options, Callbacks callbacks, const Clock* clock)
    : impl_(std::make_unique<Impl>(std::move(options), std::move(callbacks), clock)) {}
Downlink::~Downlink() { Stop(); }

void Downlink::Start() { impl_->client().Start(); }
void Downlink::Stop() { impl_->client().Stop(); }
bool Downlink::connected() const { return impl_->client().connected(); }
int64_t Downlink::heartbeat_ns() const { return impl_->heartbeat_ns(); }

bool Downlink::SendReceipt(const Receipt& receipt) {
  v1::ActuatorMessage message;
  *message.mutable_receipt() = model_proto::Encode(receipt);
  return impl_->client().Send(WithinLimits(std::move(message)));
}

bool Downlink::SendHeartbeat(const ExecutorReport& report,
                             const std::optional<model::FirewallDrops>& drops) {
  return impl_->client().Send(WithinLimits(impl_->MakeHeartbeat(report, drops)));
}

}  // namespace rips::actuator
