#include "services/model_proto/actuator_codec.h"

#include <algorithm>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "services/base/overloaded.h"
#include "services/base/status_macros.h"
#include "services/model_proto/decision_id_codec.h"
#include "services/ros2/ros_name.h"

namespace rips::model_proto {
namespace {

using Stage = model::Receipt::Stage;
using WireStage = rips::v1::Receipt;
using model::Drilled;
using WireStep = rips::v1::StepResult;

// The values are the same, so that neither direction needs a table.
static_assert(static_cast<int>(Stage::kAcknowledged) == WireStage::ACKNOWLEDGED);
static_assert(static_cast<int>(Stage::kVerified) == WireStage::VERIFIED);
static_assert(static_cast<int>(Stage::kFailed) == WireStage::FAILED);
static_assert(static_cast<int>(Stage::kSuperseded) == WireStage::SUPERSEDED);
static_assert(static_cast<int>(Stage::kRefusedStale) == WireStage::REFUSED_STALE);
static_assert(static_cast<int>(Stage::kRefused) == WireStage::REFUSED);
static_assert(static_cast<int>(Stage::kUnknown) == WireStage::UNKNOWN);
static_assert(WireStage::Stage_MAX == WireStage::UNKNOWN);
static_assert(static_cast<int>(Drilled::kNoDrill) == WireStep::DRILLED_UNSPECIFIED);
static_assert(static_cast<int>(Drilled::kDone) == WireStep::DRILLED_DONE);
static_assert(static_cast<int>(Drilled::kLooked) == WireStep::DRILLED_LOOKED);
static_assert(static_cast<int>(Drilled::kNot) == WireStep::DRILLED_NOT);
static_assert(WireStep::Drilled_MAX == WireStep::DRILLED_NOT);

constexpr size_t kCommandIdBytes = model::kCommandIdHexDigits / 2;

int64_t Nanos(uint64_t wire) { return static_cast<int64_t>(std::min<uint64_t>(wire, INT64_MAX)); }

void Encode(Instant now, rips::v1::Clock& wire) {
  wire.set_boottime_ns(static_cast<uint64_t>(now.boottime_ns));
  wire.set_unix_ns(now.unix_ns);
}

// Texts that grow past the limit when they are made printable are cut.
std::vector<std::string> DecodeDegraded(const rips::v1::ActuatorHeartbeat& wire) {
  std::vector<std::string> degraded;
  for (const std::string& text : wire.degraded()) {
    if (degraded.size() == model::kActuatorDegradedMax) break;
    const absl::string_view cut =
        absl::string_view(text).substr(0, model::kActuatorDegradedBytesMax);
    degraded.push_back(ros2::Printable(cut).substr(0, model::kActuatorDegradedBytesMax));
  }
  return degraded;
}

void Encode(const model::AuditHead& head, rips::v1::AuditHead& wire) {
  wire.set_segment(head.segment);
  wire.set_public_key(head.public_key);
  wire.set_sequence(head.sequence);
  wire.set_hash(head.hash);
  wire.set_signature(head.signature);
}

// None if a part of it is missing.
model::AuditHead Decode(const rips::v1::AuditHead& wire) {
  model::AuditHead head{.segment = wire.segment(),
                        .public_key = wire.public_key(),
                        .sequence = wire.sequence(),
                        .hash = wire.hash(),
                        .signature = wire.signature()};
  return head.whole() ? head : model::AuditHead();
}

}  // namespace

// --- server to actuator

rips::v1::Command Encode(const model::Command& command) {
  rips::v1::Command wire;
  wire.set_id(absl::HexStringToBytes(command.id));
  wire.set_term(command.term);
  wire.set_ttl_ms(command.ttl_ms);
  std::visit(
      Overloaded{[&](const model::SetLevel& set) {
                   rips::v1::SetLevel& level = *wire.mutable_set_level();
                   Encode(set.decision_id, *level.mutable_decision_id());
                   level.set_from(set.from);
                   level.set_to(set.to);
                   level.set_cause(set.cause);
                   if (!set.based_on.none()) {
                     Encode(set.based_on, *level.mutable_based_on());
                   }
                 },
                 [&](const model::RunProgram& run) {
                   rips::v1::RunProgram& program = *wire.mutable_run_program();
                   program.set_program(run.program);
                   for (const std::string& arg : run.args) program.add_args(arg);
                   program.set_timeout_ms(run.timeout_ms);
                 },
                 [&](const model::Drill& drill) { wire.mutable_drill()->set_level(drill.level); }},
      command.what);
  return wire;
}

absl::StatusOr<model::Command> Decode(const rips::v1::Command& wire) {
  if (wire.id().size() != kCommandIdBytes) {
    return absl::InvalidArgumentError(
        absl::StrCat("a command id of ", wire.id().size(), " bytes, expected ", kCommandIdBytes));
  }
  model::Command command{
      .id = absl::BytesToHexString(wire.id()), .term = wire.term(), .ttl_ms = wire.ttl_ms()};
  if (wire.has_set_level()) {
    const rips::v1::SetLevel& level = wire.set_level();
    command.what = model::SetLevel{.decision_id = Decode(level.decision_id()),
                                   .from = level.from(),
                                   .to = level.to(),
                                   .cause = level.cause(),
                                   .based_on = Decode(level.based_on())};
  } else if (wire.has_run_program() && !wire.run_program().program().empty()) {
    const rips::v1::RunProgram& run = wire.run_program();
    command.what = model::RunProgram{.program = run.program(),
                                     .args = {run.args().begin(), run.args().end()},
                                     .timeout_ms = run.timeout_ms()};
  } else if (wire.has_drill() && !wire.drill().level().empty()) {
    command.what = model::Drill{.level = wire.drill().level()};
  } else {
    return absl::InvalidArgumentError("a command that is no level, program or drill");
  }
  return command;
}

rips::v1::Lease Encode(const model::LeaseGrant& lease, Instant now) {
  rips::v1::Lease wire;
  Encode(now, *wire.mutable_heartbeat()->mutable_clock());
  wire.mutable_heartbeat()->set_echo_boottime_ns(static_cast<uint64_t>(lease.echo_boottime_ns));
  wire.set_term(lease.term);
  Encode(lease.decision_id, *wire.mutable_decision_id());
  wire.set_level(lease.level);
  wire.set_ttl_ms(lease.ttl_ms);
  wire.set_heartbeat_ms(lease.heartbeat_ms);
  wire.set_evidence_complete(lease.evidence_complete);
  if (!lease.audit_head.none()) Encode(lease.audit_head, *wire.mutable_audit_head());
  return wire;
}

model::LeaseGrant Decode(const rips::v1::Lease& wire) {
  return {.echo_boottime_ns = Nanos(wire.heartbeat().echo_boottime_ns()),
          .term = wire.term(),
          .decision_id = Decode(wire.decision_id()),
          .level = wire.level(),
          .ttl_ms = wire.ttl_ms(),
          .heartbeat_ms = wire.heartbeat_ms(),
          .evidence_complete = wire.evidence_complete(),
          .audit_head = Decode(wire.audit_head())};
}

// --- actuator to server

rips::v1::Receipt::Stage Encode(Stage stage) {
  return static_cast<rips::v1::Receipt::Stage>(stage);
}

void Encode(const std::vector<model::StepResult>& steps,
            google::protobuf::RepeatedPtrField<rips::v1::StepResult>& wire) {
  for (const model::StepResult& step : steps) {
    rips::v1::StepResult& result = *wire.Add();
    result.set_step(step.step);
    result.set_ok(step.ok);
    result.set_took_ms(step.took_ms);
    result.set_detail(step.detail);
    result.set_drilled(static_cast<rips::v1::StepResult::Drilled>(step.drilled));
    result.set_output_tail(step.output_tail);
  }
}

rips::v1::Receipt Encode(const model::Receipt& receipt) {
  rips::v1::Receipt wire;
  wire.set_command_id(absl::HexStringToBytes(receipt.command_id));
  if (!receipt.decision_id.none()) Encode(receipt.decision_id, *wire.mutable_decision_id());
  wire.set_stage(Encode(receipt.stage));
  Encode(receipt.steps, *wire.mutable_steps());
  wire.set_exit_code(receipt.exit_code);
  wire.set_output_tail(receipt.output_tail);
  wire.set_detail(receipt.detail);
  wire.set_effective_level(receipt.effective_level);
  return wire;
}

absl::StatusOr<model::Receipt> Decode(const rips::v1::Receipt& wire) {
  if (wire.stage() < WireStage::ACKNOWLEDGED || wire.stage() > WireStage::Stage_MAX) {
    return absl::InvalidArgumentError(
        absl::StrCat("unknown receipt stage ", static_cast<int>(wire.stage())));
  }
  model::Receipt receipt{.command_id = absl::BytesToHexString(wire.command_id()),
                         .decision_id = Decode(wire.decision_id()),
                         .stage = static_cast<Stage>(wire.stage()),
                         .exit_code = wire.exit_code(),
                         .output_tail = wire.output_tail(),
                         .detail = wire.detail(),
                         .effective_level = wire.effective_level()};
  for (const rips::v1::StepResult& step : wire.steps()) {
    const bool known =
        step.drilled() >= WireStep::Drilled_MIN && step.drilled() <= WireStep::Drilled_MAX;
    receipt.steps.push_back(
        {.step = step.step(),
         .ok = step.ok(),
         .took_ms = step.took_ms(),
         .detail = step.detail(),
         .drilled = known ? static_cast<Drilled>(step.drilled()) : Drilled::kNot,
         .output_tail = step.output_tail()});
  }
  return receipt;
}

rips::v1::ActuatorHello Encode(const model::ActuatorHello& hello) {
  rips::v1::ActuatorHello wire;
  wire.mutable_hello()->set_protocol(kActuatorProtocol);
  Encode(hello.clock, *wire.mutable_hello()->mutable_clock());
  for (const std::string& level : hello.levels) wire.add_levels(level);
  for (const std::string& program : hello.programs) wire.add_programs(program);
  for (const std::string& part : hello.protected_parts) wire.add_protected_parts(part);
  for (const model::InactiveParts& inactive : hello.inactive_parts) {
    rips::v1::InactiveParts& out = *wire.add_inactive_parts();
    out.set_level(inactive.level);
    for (const std::string& part : inactive.parts) {
      const auto at = std::find(hello.protected_parts.begin(), hello.protected_parts.end(), part);
      if (at == hello.protected_parts.end()) continue;
      out.add_parts(static_cast<uint32_t>(at - hello.protected_parts.begin()));
    }
  }
  for (const std::string& topic : hello.published_while_inactive) {
    wire.add_published_while_inactive(topic);
  }
  if (!hello.decision_id.none()) Encode(hello.decision_id, *wire.mutable_decision_id());
  wire.set_decided_level(hello.decided_level);
  wire.set_effective_level(hello.effective_level);
  wire.set_highest_term(hello.highest_term);
  wire.set_state_lost(hello.state_lost);
  wire.set_fail_safe_level(hello.fail_safe_level);
  if (!hello.participant.none()) wire.set_participant_guid(hello.participant.ToBytes());
  if (!hello.last_audit_head.none()) {
    Encode(hello.last_audit_head, *wire.mutable_hello()->mutable_last_audit_head());
  }
  return wire;
}

absl::StatusOr<model::ActuatorHello> Decode(const rips::v1::ActuatorHello& wire) {
  const uint32_t protocol = wire.hello().protocol();
  if (protocol == 0) return absl::InvalidArgumentError("hello has no protocol number");
  if (protocol > kActuatorProtocol) {
    return absl::FailedPreconditionError(
        absl::StrCat("protocol ", protocol, " is newer than this server's ", kActuatorProtocol,
                     "; update the server first"));
  }
  model::ActuatorHello hello{.levels = {wire.levels().begin(), wire.levels().end()},
                             .programs = {wire.programs().begin(), wire.programs().end()},
                             .decision_id = Decode(wire.decision_id()),
                             .decided_level = wire.decided_level(),
                             .effective_level = wire.effective_level(),
                             .highest_term = wire.highest_term(),
                             .state_lost = wire.state_lost(),
                             .fail_safe_level = wire.fail_safe_level()};
  hello.clock = {.boottime_ns = static_cast<int64_t>(wire.hello().clock().boottime_ns()),
                 .unix_ns = wire.hello().clock().unix_ns()};
  if (wire.hello().has_last_audit_head()) {
    hello.last_audit_head = Decode(wire.hello().last_audit_head());
    if (hello.last_audit_head.none()) {
      return absl::InvalidArgumentError("a head of an audit log that is not whole");
    }
  }
  if (!wire.participant_guid().empty()) {
    RIPS_ASSIGN_OR_RETURN(hello.participant, ros2::GuidFromBytes(wire.participant_guid()));
  }
  for (const std::string& part : wire.protected_parts()) {
    RIPS_RETURN_IF_ERROR(ros2::ValidateNodeName(part));
    hello.protected_parts.push_back(part);
  }
  for (const rips::v1::InactiveParts& inactive : wire.inactive_parts()) {
    model::InactiveParts& out = hello.inactive_parts.emplace_back();
    out.level = inactive.level();
    for (const uint32_t part : inactive.parts()) {
      if (part >= hello.protected_parts.size()) {
        return absl::InvalidArgumentError(
            absl::StrCat("inactive part ", part, " of ", hello.protected_parts.size()));
      }
      out.parts.push_back(hello.protected_parts[part]);
    }
  }
  for (const std::string& topic : wire.published_while_inactive()) {
    RIPS_RETURN_IF_ERROR(ros2::ValidateTopicName(topic));
    hello.published_while_inactive.push_back(topic);
  }
  return hello;
}

rips::v1::ActuatorHeartbeat Encode(const model::ActuatorHeartbeat& heartbeat) {
  rips::v1::ActuatorHeartbeat wire;
  wire.mutable_heartbeat()->mutable_clock()->set_boottime_ns(
      static_cast<uint64_t>(heartbeat.boottime_ns));
  wire.set_effective_level(heartbeat.effective_level);
  wire.set_observed(heartbeat.observed);
  wire.set_verified(heartbeat.verified);
  wire.set_floor_reason(heartbeat.floor_reason);
  for (const std::string& text : heartbeat.degraded) wire.add_degraded(text);
  wire.set_drifts(heartbeat.drifts);
  if (heartbeat.firewall_drops.has_value()) {
    rips::v1::FirewallDrops& drops = *wire.mutable_firewall_drops();
    drops.set_packets(heartbeat.firewall_drops->packets);
    drops.set_counted_s(heartbeat.firewall_drops->counted_s);
    drops.set_quiet_s(heartbeat.firewall_drops->quiet_s);
    for (const model::DropSource& source : heartbeat.firewall_drops->sources) {
      rips::v1::DropSource& out = *drops.add_sources();
      out.set_address(source.address);
      out.set_packets(source.packets);
      out.set_quiet_s(source.quiet_s);
    }
    drops.set_more_sources(heartbeat.firewall_drops->more_sources);
  }
  return wire;
}

model::ActuatorHeartbeat Decode(const rips::v1::ActuatorHeartbeat& wire) {
  std::optional<model::FirewallDrops> drops;
  if (wire.has_firewall_drops()) {
    drops = {.packets = wire.firewall_drops().packets(),
             .counted_s = wire.firewall_drops().counted_s(),
             .quiet_s = wire.firewall_drops().quiet_s(),
             .more_sources = wire.firewall_drops().more_sources()};
    for (const rips::v1::DropSource& source : wire.firewall_drops().sources()) {
      drops->sources.push_back({source.address(), source.packets(), source.quiet_s()});
    }
  }
  return {.boottime_ns = static_cast<int64_t>(wire.heartbeat().clock().boottime_ns()),
          .effective_level = wire.effective_level(),
          .observed = wire.observed(),
          .verified = wire.verified(),
          .floor_reason = wire.floor_reason(),
          .degraded = DecodeDegraded(wire),
          .drifts = wire.drifts(),
          .firewall_drops = drops};
}

}  // namespace rips::model_proto
