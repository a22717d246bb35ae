#include "policy_server/server/store/store.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::store {
namespace {

absl::Status Missing(absl::string_view record, absl::string_view field) {
  return absl::InvalidArgumentError(absl::StrCat(record, " without ", field));
}

absl::Status CheckNumber(absl::string_view what, uint64_t number) {
  if (number <= kNumberMax) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(what, " ", number, " exceeds ", kNumberMax));
}

absl::Status CheckDecisionId(const DecisionId& decision_id) {
  RIPS_RETURN_IF_ERROR(CheckNumber("term", decision_id.term));
  return CheckNumber("epoch", decision_id.epoch);
}

absl::Status Validate(const AckRecord& record) {
  if (record.alert_id.empty()) return Missing("acknowledgement", "alert");
  if (record.ack.by.empty()) return Missing("acknowledgement", "operator");
  if (record.ack.time_unix_ns <= 0) return Missing("acknowledgement", "time");
  if (record.ack.note.size() <= kAckNoteBytesMax) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("note of ", record.ack.note.size(), " bytes, limit ", kAckNoteBytesMax));
}

absl::Status Validate(const Maintenance& maintenance) {
  if (maintenance.none()) return absl::OkStatus();
  if (maintenance.by.empty()) return Missing("maintenance", "operator");
  if (maintenance.until_unix_ns <= maintenance.began_unix_ns) {
    return absl::InvalidArgumentError("a maintenance that ends before it begins");
  }
  if (maintenance.reason.size() <= kMaintenanceReasonBytesMax) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat("reason of ", maintenance.reason.size(),
                                                 " bytes, limit ", kMaintenanceReasonBytesMax));
}

absl::Status Validate(const Checkpoint& checkpoint) {
  if (checkpoint.bundle.has_value() && checkpoint.bundle->size() > kNoteBytesMax) {
    return absl::InvalidArgumentError("the id of a bundle is too long");
  }
  if (checkpoint.resumed_at) RIPS_RETURN_IF_ERROR(CheckDecisionId(*checkpoint.resumed_at));
  if (checkpoint.maintenance) RIPS_RETURN_IF_ERROR(Validate(*checkpoint.maintenance));
  for (const auto& [key, sequence] : checkpoint.high_water) {
    RIPS_RETURN_IF_ERROR(CheckNumber("sequence", sequence));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<Acquired> Store::Acquire(const std::string& robot) {
  RIPS_ASSIGN_OR_RETURN(std::vector<Acquired> acquired, Acquire({&robot, 1}));
  return std::move(acquired.front());
}

absl::Status Store::Commit(const WriteBatch& batch) {
  RIPS_ASSIGN_OR_RETURN(const std::vector<absl::Status> statuses, CommitAll({&batch, 1}));
  return statuses.front();
}

bool IsOfBatch(const absl::Status& status) {
  return absl::IsInvalidArgument(status) || absl::IsAlreadyExists(status) ||
         absl::IsAborted(status) || absl::IsNotFound(status);
}

absl::Status NoSuchAlert(absl::string_view alert_id) {
  return absl::NotFoundError(absl::StrCat("there is no alert ", alert_id,
                                          " in the store (any more); none was acknowledged"));
}

absl::Status Fenced(absl::string_view robot, uint64_t tenure, uint64_t stored) {
  return absl::AbortedError(absl::StrCat("tenure ", tenure, " of robot `", robot,
                                         "` is over: the robot was acquired with tenure ", stored));
}

absl::Status Validate(const WriteBatch& batch) {
  if (batch.robot.empty()) return Missing("batch", "robot");
  RIPS_RETURN_IF_ERROR(CheckNumber("tenure", batch.tenure));
  if (batch.tenure == 0 &&
      (!batch.decisions.empty() || !batch.refusals.empty() || !batch.stages.empty() ||
       !batch.receipts.empty() || !batch.checkpoint.empty())) {
    return Missing("batch", "tenure");
  }
  if (batch.uses_reserve &&
      (!batch.refusals.empty() || !batch.stages.empty() || !batch.alerts.empty() ||
       !batch.receipts.empty() || !batch.acks.empty() || !batch.checkpoint.empty())) {
    return absl::InvalidArgumentError("the reserve is for decisions alone");
  }
  for (const ReceiptRecord& receipt : batch.receipts) {
    if (receipt.host.empty()) return Missing("receipt", "host");
    if (receipt.receipt.command_id.empty()) return Missing("receipt", "command");
  }
  for (const DecisionRecord& decision : batch.decisions) {
    if (decision.id.empty()) return Missing("decision", "id");
    if (decision.decision_id.term == 0 || decision.decision_id.epoch == 0)
      return Missing("decision", "decision_id");
    if (decision.to.empty()) return Missing("decision", "level");
    RIPS_RETURN_IF_ERROR(CheckDecisionId(decision.decision_id));
    RIPS_RETURN_IF_ERROR(CheckDecisionId(decision.based_on));
  }
  for (const RefusalRecord& refusal : batch.refusals) {
    if (refusal.id.empty()) return Missing("refusal", "id");
    RIPS_RETURN_IF_ERROR(CheckNumber("count", refusal.count));
  }
  for (const StageUpdate& update : batch.stages) {
    if (update.stage.empty()) return Missing("stage", "name");
    RIPS_RETURN_IF_ERROR(CheckDecisionId(update.decision_id));
  }
  for (const AlertRecord& alert : batch.alerts) {
    if (alert.id.empty()) return Missing("alert", "id");
    if (alert.robot != batch.robot) {
      return absl::InvalidArgumentError(absl::StrCat("alert of robot `", alert.robot,
                                                     "` in a batch of robot `", batch.robot, "`"));
    }
    RIPS_RETURN_IF_ERROR(CheckDecisionId(alert.decision_id));
  }
  for (const AckRecord& ack : batch.acks) RIPS_RETURN_IF_ERROR(Validate(ack));
  return Validate(batch.checkpoint);
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
