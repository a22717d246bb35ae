#include "policy_server/server/audit/store_audit.h"

#include <algorithm>
#include <bit>
#include <string>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "services/model_proto/decision_id_codec.h"

namespace rips::audit {
namespace {

using v1::AuditRecord;

// The rule of RIPS's own alerts.
constexpr char kOwnRule[] = "(rips)";
constexpr char kRunsBundle[] = "runs bundle ";
constexpr char kSoftLevels[] = "soft levels";

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

AuditRecord Of(const store::AckRecord& ack) {
  AuditRecord record;
  record.set_kind(AuditRecord::KIND_ACK);
  record.set_time_unix_ns(ack.ack.time_unix_ns);
  record.set_robot(ack.robot);
  record.set_id(ack.alert_id);
  record.set_actor(ack.ack.by);
  record.set_action(ack.rule);
  record.set_text(ack.ack.note);
  record.set_outcome(ack.severity);
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
  if (checkpoint.bundle) add(absl::StrCat(kRunsBundle, *checkpoint.bundle));
  if (checkpoint.rules_halted) {
    add(*checkpoint.rules_halted ? "a rule called crash: no rule runs" : "rules run");
  }
  if (checkpoint.soft_suspended) {
    add(absl::StrCat(*checkpoint.soft_suspended ? "rules may not lower " : "rules may lower ",
                     kSoftLevels));
  }
}

// What a record is known by. A refusal is recorded again with a higher count; of a policy, its
// subject.
std::string KeyOf(const AuditRecord& record) {
  if (record.kind() == AuditRecord::KIND_ACK) {
    return absl::StrCat(record.id(), " ", record.actor());
  }
  if (record.kind() != AuditRecord::KIND_POLICY)
    return absl::StrCat(record.id(), " ", record.count());
  const absl::string_view subject = absl::StartsWith(record.text(), kRunsBundle)    ? "bundle"
                                    : absl::StrContains(record.text(), kSoftLevels) ? "lowering"
                                                                                    : "rules";
  return absl::StrCat(record.robot(), "/", subject);
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
    for (const store::AckRecord& ack : batch.acks) out.push_back(Of(ack));
    AddPolicy(batch.robot, batch.checkpoint, out);
  }
  return out;
}

bool StoreAudit::Knows(const AuditRecord& record) const {
  if (record.kind() != AuditRecord::KIND_POLICY) return known_.contains(KeyOf(record));
  const auto known = policies_.find(KeyOf(record));
  return known != policies_.end() && known->second == record.text();
}

void StoreAudit::Remember(const std::vector<AuditRecord>& records) {
  for (const AuditRecord& record : records) {
    if (record.kind() == AuditRecord::KIND_POLICY) {
      policies_[KeyOf(record)] = record.text();
    } else if (known_.insert(KeyOf(record)).second) {
      order_.push_back(KeyOf(record));
    }
  }
  for (; order_.size() > kRememberedMax; order_.pop_front()) known_.erase(order_.front());
}

absl::Status StoreAudit::RecordBefore(std::span<const store::WriteBatch> batches) {
  std::vector<AuditRecord> records = RecordsOf(batches);
  std::erase_if(records, [this](const AuditRecord& record) { return Knows(record); });
  const bool healthy = log_->health().ok();
  if (records.empty() && healthy) return absl::OkStatus();
  const bool raises =
      std::all_of(batches.begin(), batches.end(),
                  [](const store::WriteBatch& batch) { return batch.uses_reserve; });
  const absl::Status status = raises && !healthy
                                  ? absl::UnavailableError("it could not be written before")
                                  : log_->Commit(records);
  if (!status.ok() && !raises) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the audit log cannot be written: ", status.message()));
  }
  Remember(records);
  if (!status.ok()) {
    for (AuditRecord& record : records) log_->Add(std::move(record));
  }
  return absl::OkStatus();
}

}  // namespace rips::audit
