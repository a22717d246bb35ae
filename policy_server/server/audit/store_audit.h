// What a commit of the store leaves in the audit log, and that it is there first.
#ifndef RIPS_POLICY_SERVER_SERVER_AUDIT_STORE_AUDIT_H_
#define RIPS_POLICY_SERVER_SERVER_AUDIT_STORE_AUDIT_H_

#include <span>
#include <vector>

#include "absl/status/status.h"
#include "policy_server/server/audit/audit_log.h"
#include "policy_server/server/store/records.h"
#include "rips/v1/audit.pb.h"

namespace rips::audit {

// In order: decisions; refusals when their count is 1, 2, 4, 8, ...; RIPS's own alerts; bundles,
// and whether rules run and lower. Stages, alerts of rules and variables are the store's alone.
std::vector<v1::AuditRecord> RecordsOf(std::span<const store::WriteBatch> batches);

// For Committer::BeforeCommit. OK when what the batches leave is durable in `log`. While it cannot
// be written: ResourceExhausted, so that nothing is stored, but for batches that use the reserve
// alone (raises), which leave their records to be written later. Any thread; blocks on the disk.
absl::Status RecordBefore(AuditLog& log, std::span<const store::WriteBatch> batches);

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_SERVER_AUDIT_STORE_AUDIT_H_
