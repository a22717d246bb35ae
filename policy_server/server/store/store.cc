#include "policy_server/server/store/store.h"

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::store {
namespace {

absl::Status Missing(absl::string_view record, absl::string_view field) {
  return absl::InvalidArgumentError(absl::StrCat(record, " without ", field));
}

absl::Status CheckNames(absl::string_view record, const std::string& robot, const std::string& id) {
  if (robot.empty()) return Missing(record, "robot");
  if (id.empty()) return Missing(record, "id");
  return absl::OkStatus();
}

absl::Status CheckNumber(absl::string_view what, uint64_t number) {
  if (number <= kNumberMax) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(what, " ", number, " exceeds ", kNumberMax));
}

absl::Status CheckDecisionId(const DecisionId& decision_id) {
  RIPS_RETURN_IF_ERROR(CheckNumber("term", decision_id.term));
  return CheckNumber("epoch", decision_id.epoch);
}

}  // namespace

absl::Status Validate(const WriteBatch& batch) {
  if (batch.uses_reserve && (!batch.refusals.empty() || !batch.stages.empty() ||
                             !batch.alerts.empty() || !batch.checkpoints.empty())) {
    return absl::InvalidArgumentError("the reserve is for decisions alone");
  }
  for (const DecisionRecord& decision : batch.decisions) {
    RIPS_RETURN_IF_ERROR(CheckNames("decision", decision.robot, decision.id));
    if (decision.decision_id.term == 0 || decision.decision_id.epoch == 0)
      return Missing("decision", "decision_id");
    if (decision.to.empty()) return Missing("decision", "level");
    RIPS_RETURN_IF_ERROR(CheckDecisionId(decision.decision_id));
    RIPS_RETURN_IF_ERROR(CheckDecisionId(decision.based_on));
  }
  for (const RefusalRecord& refusal : batch.refusals) {
    RIPS_RETURN_IF_ERROR(CheckNames("refusal", refusal.robot, refusal.id));
    RIPS_RETURN_IF_ERROR(CheckNumber("count", refusal.count));
  }
  for (const StageUpdate& update : batch.stages) {
    if (update.robot.empty()) return Missing("stage", "robot");
    if (update.stage.empty()) return Missing("stage", "name");
    RIPS_RETURN_IF_ERROR(CheckDecisionId(update.decision_id));
  }
  for (const AlertRecord& alert : batch.alerts) {
    RIPS_RETURN_IF_ERROR(CheckNames("alert", alert.robot, alert.id));
    RIPS_RETURN_IF_ERROR(CheckDecisionId(alert.decision_id));
  }
  for (const Checkpoint& checkpoint : batch.checkpoints) {
    if (checkpoint.robot.empty()) return Missing("checkpoint", "robot");
    if (checkpoint.bundle.has_value() && checkpoint.bundle->size() > kNoteBytesMax) {
      return absl::InvalidArgumentError("the id of a bundle is too long");
    }
    if (checkpoint.resumed_at) RIPS_RETURN_IF_ERROR(CheckDecisionId(*checkpoint.resumed_at));
    for (const auto& [key, sequence] : checkpoint.high_water) {
      RIPS_RETURN_IF_ERROR(CheckNumber("sequence", sequence));
    }
  }
  return absl::OkStatus();
}

absl::Status CheckGeneration(absl::string_view id) {
  if (id.size() == kGenerationBytes) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("generation of ", id.size(), " bytes, not ", kGenerationBytes));
}

absl::Status CheckNote(absl::string_view name, absl::string_view value) {
  if (name.empty()) return Missing("note", "name");
  if (value.size() <= kNoteBytesMax) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("note of ", value.size(), " bytes, limit ", kNoteBytesMax));
}

}  // namespace rips::store
