#include "mode_actuator/link/downlink.h"

#include <algorithm>
#include <atomic>
#include <utility>

#include "absl/strings/str_cat.h"
#include "rips/v1/actuator.grpc.pb.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/daemon_flags.h"
#include "services/wire_limits/field_limits.h"

namespace rips::actuator {
namespace {

using Client = rpc::BidiClient<v1::ActuatorMessage, v1::ActuatorReply>;

constexpr uint32_t kProtocol = 1;
constexpr size_t kCommandIdBytes = 16;

DecisionId FromProto(const v1::DecisionId& decision_id) {
  return {.term = decision_id.term(), .epoch = decision_id.epoch()};
}

void ToProto(const DecisionId& decision_id, v1::DecisionId* out) {
  out->set_term(decision_id.term);
  out->set_epoch(decision_id.epoch);
}

void ToProto(const Instant& now, v1::Clock* out) {
  out->set_boottime_ns(static_cast<uint64_t>(now.boottime_ns));
  out->set_unix_ns(now.unix_ns);
}

v1::Receipt::Stage ToProto(Receipt::Stage stage) {
  switch (stage) {
    case Receipt::Stage::kAcknowledged:
      return v1::Receipt::ACKNOWLEDGED;
    case Receipt::Stage::kVerified:
      return v1::Receipt::VERIFIED;
    case Receipt::Stage::kFailed:
      return v1::Receipt::FAILED;
    case Receipt::Stage::kSuperseded:
      return v1::Receipt::SUPERSEDED;
    case Receipt::Stage::kRefusedStale:
      return v1::Receipt::REFUSED_STALE;
    case Receipt::Stage::kRefused:
      return v1::Receipt::REFUSED;
    case Receipt::Stage::kUnknown:
      break;
  }
  return v1::Receipt::UNKNOWN;
}

v1::StepResult::Drilled ToProto(Drilled drilled) {
  switch (drilled) {
    case Drilled::kNoDrill:
      return v1::StepResult::DRILLED_UNSPECIFIED;
    case Drilled::kDone:
      return v1::StepResult::DRILLED_DONE;
    case Drilled::kLooked:
      return v1::StepResult::DRILLED_LOOKED;
    case Drilled::kNot:
      break;
  }
  return v1::StepResult::DRILLED_NOT;
}

void ToProto(const Receipt& receipt, v1::Receipt* out) {
  out->set_command_id(receipt.command_id);
  if (!receipt.decision_id.none()) ToProto(receipt.decision_id, out->mutable_decision_id());
  out->set_stage(ToProto(receipt.stage));
  for (const StepResult& step : receipt.steps) {
    v1::StepResult* result = out->add_steps();
    result->set_step(step.step);
    result->set_ok(step.ok);
    result->set_took_ms(step.took_ms);
    result->set_detail(step.detail);
    result->set_drilled(ToProto(step.drilled));
    result->set_output_tail(step.output_tail);
  }
  out->set_exit_code(receipt.exit_code);
  out->set_output_tail(receipt.output_tail);
  out->set_detail(receipt.detail);
  out->set_effective_level(receipt.effective_level);
}

// What robots, programs and devices said may be too long for the server, which would end the
// stream; here it is cut.
v1::ActuatorMessage WithinLimits(v1::ActuatorMessage message) {
  wire_limits::CutToLimits(message);
  return message;
}

int64_t Nanos(uint64_t wire) { return static_cast<int64_t>(std::min<uint64_t>(wire, INT64_MAX)); }

}  // namespace

absl::StatusOr<AnyCommand> DecodeCommand(const v1::Command& command) {
  if (command.id().size() != kCommandIdBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("a command id of ", command.id().size(), " bytes, expected 16"));
  }
  if (command.has_set_level()) {
    const v1::SetLevel& level = command.set_level();
    SetLevelCommand decoded;
    decoded.id = command.id();
    decoded.term = command.term();
    decoded.decision_id = FromProto(level.decision_id());
    decoded.to = level.to();
    if (level.has_based_on()) decoded.based_on = FromProto(level.based_on());
    return decoded;
  }
  if (command.has_run_program() && !command.run_program().program().empty()) {
    const v1::RunProgram& run = command.run_program();
    RunProgramCommand decoded;
    decoded.id = command.id();
    decoded.term = command.term();
    decoded.program = run.program();
    decoded.args.assign(run.args().begin(), run.args().end());
    decoded.timeout = absl::Milliseconds(run.timeout_ms());
    return decoded;
  }
  if (command.has_drill() && !command.drill().level().empty()) {
    return DrillCommand{
        .id = command.id(), .term = command.term(), .level = command.drill().level()};
  }
  return absl::InvalidArgumentError("a command that is no level, program or drill");
}

LeaseGrant DecodeLease(const v1::Lease& lease) {
  return {.term = lease.term(),
          .echo_boottime_ns = Nanos(lease.heartbeat().echo_boottime_ns()),
          .ttl_ns = int64_t{lease.ttl_ms()} * kNanosPerMilli,
          .evidence_complete = lease.evidence_complete()};
}

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

  v1::ActuatorMessage MakeHeartbeat(const ExecutorReport& report) const {
    v1::ActuatorMessage message;
    v1::ActuatorHeartbeat* heartbeat = message.mutable_heartbeat();
    ToProto(clock_->Now(), heartbeat->mutable_heartbeat()->mutable_clock());
    heartbeat->mutable_heartbeat()->set_echo_boottime_ns(newest_boottime_ns_);
    heartbeat->set_effective_level(report.effective);
    heartbeat->set_observed(report.observed);
    heartbeat->set_verified(report.verified);
    heartbeat->set_floor_reason(report.floor_reason);
    for (const std::string& text : report.degraded) heartbeat->add_degraded(text);
    heartbeat->set_drifts(report.drifts);
    return message;
  }

 private:
  v1::ActuatorMessage MakeHello() {
    newest_boottime_ns_ = 0;
    const ExecutorReport report = callbacks_.connected();
    v1::ActuatorMessage message;
    v1::ActuatorHello* hello = message.mutable_hello();
    hello->mutable_hello()->set_protocol(kProtocol);
    hello->mutable_hello()->set_version(std::string(RipsVersion()));
    hello->mutable_hello()->set_incarnation(options_.incarnation);
    hello->mutable_hello()->set_host(options_.host);
    ToProto(clock_->Now(), hello->mutable_hello()->mutable_clock());
    for (const std::string& level : options_.levels) hello->add_levels(level);
    hello->set_fail_safe_level(options_.fail_safe_level);
    for (const std::string& program : options_.programs) hello->add_programs(program);
    for (const std::string& part : options_.protected_parts) hello->add_protected_parts(part);
    if (!report.decision_id.none()) ToProto(report.decision_id, hello->mutable_decision_id());
    hello->set_decided_level(report.decided);
    hello->set_effective_level(report.effective);
    hello->set_state_lost(report.state_lost);
    hello->set_participant_guid(options_.participant_guid);
    hello->set_highest_term(report.highest_term);
    return message;
  }

  void OnReply(const v1::ActuatorReply& reply) {
    if (reply.has_lease()) {
      const uint64_t boottime_ns = reply.lease().heartbeat().clock().boottime_ns();
      if (boottime_ns > newest_boottime_ns_) newest_boottime_ns_ = boottime_ns;
      callbacks_.lease(DecodeLease(reply.lease()));
    } else if (reply.has_command()) {
      auto command = DecodeCommand(reply.command());
      if (!command.ok()) {
        callbacks_.malformed(command.status());
      } else if (auto* level = std::get_if<SetLevelCommand>(&*command)) {
        callbacks_.set_level(std::move(*level));
      } else if (auto* drill = std::get_if<DrillCommand>(&*command)) {
        callbacks_.drill(std::move(*drill));
      } else {
        callbacks_.run_program(std::get<RunProgramCommand>(*std::move(command)));
      }
    }
    // Anything else is of a later protocol, and ignored.
  }

  const Options options_;
  const Callbacks callbacks_;
  const Clock* const clock_;                      // Not owned; outlives this.
  std::atomic<uint64_t> newest_boottime_ns_ = 0;  // the server's, of this stream
  std::unique_ptr<Client> client_;
};

Downlink::Downlink(Options options, Callbacks callbacks, const Clock* clock)
    : impl_(std::make_unique<Impl>(std::move(options), std::move(callbacks), clock)) {}
Downlink::~Downlink() { Stop(); }

void Downlink::Start() { impl_->client().Start(); }
void Downlink::Stop() { impl_->client().Stop(); }
bool Downlink::connected() const { return impl_->client().connected(); }

bool Downlink::SendReceipt(const Receipt& receipt) {
  v1::ActuatorMessage message;
  ToProto(receipt, message.mutable_receipt());
  return impl_->client().Send(WithinLimits(std::move(message)));
}

bool Downlink::SendHeartbeat(const ExecutorReport& report) {
  return impl_->client().Send(WithinLimits(impl_->MakeHeartbeat(report)));
}

}  // namespace rips::actuator
