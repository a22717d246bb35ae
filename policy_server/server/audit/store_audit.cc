#include "policy_server/server/audit/store_audit.h"

#include <algorithm>
#include <bit>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/model_proto/decision_id_codec.h"

namespace rips::audit {
namespace {

using v1::AuditRecord;

// The rule of RIPS's own alerts.
constexpr char kOwnRule[] = "(rips)";

// Of a decision or a refusal.
template <typename Change>
AuditRecord OfChange(const std::string& robot, const Change& change, AuditRecord::Kind kind) {
  AuditRecord record;
  record.set_kind(kind);
  record.set_time_unix_ns(change.time_unix_ns);
  record.set_robot(robot);
  record.set_id(change.id);
  record.set_actor(change.cause);
  record.set_from(change.from);
  record.set_to(change.to);
  record.set_text(change.reason);
  return record;
}

AuditRecord Of(const std::string& robot, const store::DecisionRecord& decision) {
  AuditRecord record = OfChange(robot, decision, AuditRecord::KIND_DECISION);
  model_proto::Encode(decision.decision_id, *record.mutable_decision_id());
  if (decision.based_on != DecisionId())
    model_proto::Encode(decision.based_on, *record.mutable_based_on());
  return record;
}

AuditRecord Of(const std::string& robot, const store::RefusalRecord& refusal) {
  AuditRecord record = OfChange(robot, refusal, AuditRecord::KIND_REFUSAL);
  record.set_count(refusal.count);
  return record;
}

AuditRecord Of(const store::AlertRecord& alert) {
  AuditRecord record;
  record.set_kind(AuditRecord::KIND_ALERT);
  record.set_time_unix_ns(alert.time_unix_ns);
  record.set_robot(alert.robot);
  record.set_id(alert.id);
  record.set_actor(alert.rule);
  record.set_text(alert.text);
  record.set_outcome(alert.severity);
  return record;
}

void AddPolicy(const std::string& robot, const store::Checkpoint& checkpoint,
               std::vector<AuditRecord>& out) {
  const auto add = [&](std::string text) {
    AuditRecord& record = out.emplace_back();
    record.set_kind(AuditRecord::KIND_POLICY);
    record.set_robot(robot);
    record.set_actor(kOwnRule);
    record.set_text(std::move(text));
  };
  if (checkpoint.bundle) add(absl::StrCat("runs bundle ", *checkpoint.bundle));
  if (checkpoint.rules_halted) {
    add(*checkpoint.rules_halted ? "a rule called crash: no rule runs" : "rules run");
  }
  if (checkpoint.soft_suspended) {
    add(*checkpoint.soft_suspended ? "rules may not lower soft levels"
                                   : "rules may lower soft levels");
  }
}

}  // namespace

std::vector<AuditRecord> RecordsOf(std::span<const store::WriteBatch> batches) {
  std::vector<AuditRecord> out;
  for (const store::WriteBatch& batch : batches) {
    for (const store::DecisionRecord& decision : batch.decisions) {
      out.push_back(Of(batch.robot, decision));
    }
    for (const store::RefusalRecord& refusal : batch.refusals) {
      if (std::has_single_bit(refusal.count)) out.push_back(Of(batch.robot, refusal));
    }
    for (const store::AlertRecord& alert : batch.alerts) {
      if (alert.rule == kOwnRule) out.push_back(Of(alert));
    }
    AddPolicy(batch.robot, batch.checkpoint, out);
  }
  return out;
}

absl::Status RecordBefore(AuditLog& log, std::span<const store::WriteBatch> batches) {
  std::vector<AuditRecord> records = RecordsOf(batches);
  const bool healthy = log.health().ok();
  if (records.empty() && healthy) return absl::OkStatus();
  const bool raises =
      std::all_of(batches.begin(), batches.end(),
                  [](const store::WriteBatch& batch) { return batch.uses_reserve; });
  if (raises && !healthy) {
    for (AuditRecord& record : records) log.Add(std::move(record));
    return absl::OkStatus();
  }
  const absl::Status status = log.Commit(raises ? records : std::move(records));
  if (status.ok()) return absl::OkStatus();
  if (raises) {
    for (AuditRecord& record : records) log.Add(std::move(record));
    return absl::OkStatus();
  }
  return absl::ResourceExhaustedError(
      absl::StrCat("the audit log cannot be written: ", status.message()));
}

}  // namespace rips::audit
