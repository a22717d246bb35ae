// What a commit of the store leaves in the audit log, and that it is there first.
#ifndef RIPS_POLICY_SERVER_SERVER_AUDIT_STORE_AUDIT_H_
#define RIPS_POLICY_SERVER_SERVER_AUDIT_STORE_AUDIT_H_

#include <cstddef>
#include <deque>
#include <map>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "policy_server/server/audit/audit_log.h"
#include "policy_server/server/store/records.h"
#include "rips/v1/audit.pb.h"

namespace rips::audit {

// In order: decisions; refusals when their count is 1, 2, 4, 8, ...; RIPS's own alerts;
// acknowledgements; bundles, and whether rules run and lower. Stages, alerts of rules and variables
// are the store's alone.
std::vector<v1::AuditRecord> RecordsOf(std::span<const store::WriteBatch> batches);

// What one store's commits leave in `log`, each once: a batch that the store could not write comes
// again, and a checkpoint says of a policy what it said before. Not thread-safe.
class StoreAudit {
 public:
  // Records that it remembers; an older one that comes again is recorded again.
  static constexpr size_t kRememberedMax = 10'000;

  // `log` outlives this.
  explicit StoreAudit(AuditLog* log) : log_(log) {}

  // For Committer::BeforeCommit. OK when what the batches leave is durable in the log. While it
  // cannot be written: ResourceExhausted, so that nothing is stored, but for batches that use the
  // reserve alone (raises), which leave their records to be written later. Blocks on the disk.
  absl::Status RecordBefore(std::span<const store::WriteBatch> batches);

 private:
  bool Knows(const v1::AuditRecord& record) const;
  void Remember(const std::vector<v1::AuditRecord>& records);

  AuditLog* log_;
  // The newest text by robot and what it is about.
  std::map<std::string, std::string> policies_;
  // Of the other records; `order_`, the oldest first, bounds them.
  std::set<std::string> known_;
  std::deque<std::string> order_;
};

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_SERVER_AUDIT_STORE_AUDIT_H_
