#include "policy_server/server/operator_api/receipt_codec.h"

#include <vector>

#include "absl/strings/escaping.h"

namespace rips::operator_api {
namespace {

rips::v1::Receipt::Stage Encode(pipeline::Receipt::Stage stage) {
  using Stage = pipeline::Receipt::Stage;
  switch (stage) {
    case Stage::kAcknowledged:
      return rips::v1::Receipt::ACKNOWLEDGED;
    case Stage::kVerified:
      return rips::v1::Receipt::VERIFIED;
    case Stage::kFailed:
      return rips::v1::Receipt::FAILED;
    case Stage::kSuperseded:
      return rips::v1::Receipt::SUPERSEDED;
    case Stage::kRefusedStale:
      return rips::v1::Receipt::REFUSED_STALE;
    case Stage::kRefused:
      return rips::v1::Receipt::REFUSED;
    case Stage::kUnknown:
      return rips::v1::Receipt::UNKNOWN;
  }
  return rips::v1::Receipt::STAGE_UNSPECIFIED;
}

rips::v1::StepResult::Drilled Encode(pipeline::StepReport::Drilled drilled) {
  using Drilled = pipeline::StepReport::Drilled;
  switch (drilled) {
    case Drilled::kNoDrill:
      return rips::v1::StepResult::DRILLED_UNSPECIFIED;
    case Drilled::kDone:
      return rips::v1::StepResult::DRILLED_DONE;
    case Drilled::kLooked:
      return rips::v1::StepResult::DRILLED_LOOKED;
    case Drilled::kNot:
      return rips::v1::StepResult::DRILLED_NOT;
  }
  return rips::v1::StepResult::DRILLED_UNSPECIFIED;
}

void Encode(const std::vector<pipeline::StepReport>& steps,
            google::protobuf::RepeatedPtrField<rips::v1::StepResult>* out) {
  for (const pipeline::StepReport& step : steps) {
    rips::v1::StepResult* result = out->Add();
    result->set_step(step.step);
    result->set_ok(step.ok);
    result->set_took_ms(step.took_ms);
    result->set_detail(step.detail);
    result->set_drilled(Encode(step.drilled));
    result->set_output_tail(step.output_tail);
  }
}

}  // namespace

void Encode(const pipeline::LoggedReceipt& receipt, rips::v1::ReceivedReceipt* out) {
  out->set_unix_ns(receipt.unix_ns);
  out->set_host(receipt.host);
  out->set_command(receipt.command);
  rips::v1::Receipt* inner = out->mutable_receipt();
  inner->set_command_id(absl::HexStringToBytes(receipt.receipt.command_id));
  if (!receipt.receipt.decision_id.none()) {
    inner->mutable_decision_id()->set_term(receipt.receipt.decision_id.term);
    inner->mutable_decision_id()->set_epoch(receipt.receipt.decision_id.epoch);
  }
  inner->set_stage(Encode(receipt.receipt.stage));
  Encode(receipt.receipt.steps, inner->mutable_steps());
  inner->set_exit_code(receipt.receipt.exit_code);
  inner->set_output_tail(receipt.receipt.output_tail);
  inner->set_detail(receipt.receipt.detail);
  inner->set_effective_level(receipt.receipt.effective_level);
}

void Encode(const pipeline::DrillEntry& drill, rips::v1::ActuatorDrill* out) {
  out->set_level(drill.level);
  out->set_host(drill.host);
  if (drill.stage) out->set_stage(Encode(*drill.stage));
  Encode(drill.steps, out->mutable_steps());
  out->set_detail(drill.detail);
}

}  // namespace rips::operator_api
