#include "policy_server/server/dispatch/actuator_codec.h"

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::dispatch {
namespace {

constexpr uint32_t kProtocol = 1;

DecisionId DecodeDecisionId(const rips::v1::DecisionId& decision_id) {
  return {.term = decision_id.term(), .epoch = decision_id.epoch()};
}

void EncodeDecisionId(const DecisionId& decision_id, rips::v1::DecisionId* out) {
  out->set_term(decision_id.term);
  out->set_epoch(decision_id.epoch);
}

absl::StatusOr<pipeline::Receipt::Stage> DecodeStage(rips::v1::Receipt::Stage stage) {
  using Stage = pipeline::Receipt::Stage;
  switch (stage) {
    case rips::v1::Receipt::ACKNOWLEDGED:
      return Stage::kAcknowledged;
    case rips::v1::Receipt::VERIFIED:
      return Stage::kVerified;
    case rips::v1::Receipt::FAILED:
      return Stage::kFailed;
    case rips::v1::Receipt::SUPERSEDED:
      return Stage::kSuperseded;
    case rips::v1::Receipt::REFUSED_STALE:
      return Stage::kRefusedStale;
    case rips::v1::Receipt::REFUSED:
      return Stage::kRefused;
    case rips::v1::Receipt::UNKNOWN:
      return Stage::kUnknown;
    default:
      return absl::InvalidArgumentError(
          absl::StrCat("unknown receipt stage ", static_cast<int>(stage)));
  }
}

// A value of a newer protocol counts as not tried.
pipeline::StepReport::Drilled DecodeDrilled(rips::v1::StepResult::Drilled drilled) {
  using Drilled = pipeline::StepReport::Drilled;
  switch (drilled) {
    case rips::v1::StepResult::DRILLED_UNSPECIFIED:
      return Drilled::kNoDrill;
    case rips::v1::StepResult::DRILLED_DONE:
      return Drilled::kDone;
    case rips::v1::StepResult::DRILLED_LOOKED:
      return Drilled::kLooked;
    default:
      return Drilled::kNot;
  }
}

// Texts that grow past the limit when they are made printable are cut.
std::vector<std::string> DecodeDegraded(const rips::v1::ActuatorHeartbeat& heartbeat) {
  std::vector<std::string> degraded;
  for (const std::string& text : heartbeat.degraded()) {
    if (degraded.size() == pipeline::kActuatorDegradedMax) break;
    const absl::string_view cut =
        absl::string_view(text).substr(0, pipeline::kActuatorDegradedBytesMax);
    degraded.push_back(ros2::Printable(cut).substr(0, pipeline::kActuatorDegradedBytesMax));
  }
  return degraded;
}

}  // namespace

absl::StatusOr<pipeline::ActuatorHello> DecodeHello(const rips::v1::ActuatorHello& hello) {
  if (hello.hello().protocol() == 0) {
    return absl::InvalidArgumentError("hello has no protocol number");
  }
  if (hello.hello().protocol() > kProtocol) {
    return absl::FailedPreconditionError(absl::StrCat("protocol ", hello.hello().protocol(),
                                                      " is newer than this server's ", kProtocol,
                                                      "; update the server first"));
  }
  pipeline::ActuatorHello decoded{
      .levels = {hello.levels().begin(), hello.levels().end()},
      .programs = {hello.programs().begin(), hello.programs().end()},
      .decision_id = DecodeDecisionId(hello.decision_id()),
      .decided_level = hello.decided_level(),
      .effective_level = hello.effective_level(),
      .highest_term = hello.highest_term(),
      .state_lost = hello.state_lost(),
      .fail_safe_level = hello.fail_safe_level(),
      .clock = {.boottime_ns = static_cast<int64_t>(hello.hello().clock().boottime_ns()),
                .unix_ns = hello.hello().clock().unix_ns()}};
  if (!hello.participant_guid().empty()) {
    RIPS_ASSIGN_OR_RETURN(decoded.participant, ros2::GuidFromBytes(hello.participant_guid()));
  }
  for (const std::string& part : hello.protected_parts()) {
    RIPS_RETURN_IF_ERROR(ros2::ValidateNodeName(part));
    decoded.protected_parts.push_back(part);
  }
  return decoded;
}

absl::StatusOr<pipeline::Receipt> DecodeReceipt(const rips::v1::Receipt& receipt) {
  pipeline::Receipt decoded{.command_id = absl::BytesToHexString(receipt.command_id()),
                            .decision_id = DecodeDecisionId(receipt.decision_id()),
                            .exit_code = receipt.exit_code(),
                            .output_tail = receipt.output_tail(),
                            .detail = receipt.detail(),
                            .effective_level = receipt.effective_level()};
  RIPS_ASSIGN_OR_RETURN(decoded.stage, DecodeStage(receipt.stage()));
  for (const rips::v1::StepResult& step : receipt.steps()) {
    decoded.steps.push_back({.step = step.step(),
                             .ok = step.ok(),
                             .took_ms = step.took_ms(),
                             .detail = step.detail(),
                             .drilled = DecodeDrilled(step.drilled()),
                             .output_tail = step.output_tail()});
  }
  return decoded;
}

pipeline::ActuatorHeartbeat DecodeHeartbeat(const rips::v1::ActuatorHeartbeat& heartbeat) {
  return {.boottime_ns = static_cast<int64_t>(heartbeat.heartbeat().clock().boottime_ns()),
          .effective_level = heartbeat.effective_level(),
          .observed = heartbeat.observed(),
          .verified = heartbeat.verified(),
          .floor_reason = heartbeat.floor_reason(),
          .degraded = DecodeDegraded(heartbeat),
          .drifts = heartbeat.drifts()};
}

rips::v1::Command EncodeCommand(const pipeline::Command& command) {
  rips::v1::Command out;
  out.set_id(absl::HexStringToBytes(command.id));
  out.set_term(command.term);
  out.set_ttl_ms(command.ttl_ms);
  if (const auto* set = std::get_if<pipeline::SetLevel>(&command.what)) {
    rips::v1::SetLevel* level = out.mutable_set_level();
    EncodeDecisionId(set->decision_id, level->mutable_decision_id());
    level->set_from(set->from);
    level->set_to(set->to);
    level->set_cause(set->cause);
    if (!set->based_on.none()) EncodeDecisionId(set->based_on, level->mutable_based_on());
  } else if (const auto* run = std::get_if<pipeline::RunProgram>(&command.what)) {
    rips::v1::RunProgram* program = out.mutable_run_program();
    program->set_program(run->program);
    for (const std::string& arg : run->args) program->add_args(arg);
    program->set_timeout_ms(run->timeout_ms);
  } else if (const auto* drill = std::get_if<pipeline::Drill>(&command.what)) {
    out.mutable_drill()->set_level(drill->level);
  }
  return out;
}

rips::v1::Lease EncodeLease(const pipeline::LeaseGrant& lease, Instant now) {
  rips::v1::Lease out;
  rips::v1::Heartbeat* heartbeat = out.mutable_heartbeat();
  heartbeat->mutable_clock()->set_boottime_ns(static_cast<uint64_t>(now.boottime_ns));
  heartbeat->mutable_clock()->set_unix_ns(now.unix_ns);
  heartbeat->set_echo_boottime_ns(static_cast<uint64_t>(lease.echo_boottime_ns));
  out.set_term(lease.term);
  EncodeDecisionId(lease.decision_id, out.mutable_decision_id());
  out.set_level(lease.level);
  out.set_ttl_ms(lease.ttl_ms);
  out.set_evidence_complete(lease.evidence_complete);
  return out;
}

}  // namespace rips::dispatch
