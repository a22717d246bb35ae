// A head that an actuator brings back, compared with the log it is said to be of.
#ifndef RIPS_POLICY_SERVER_AUDIT_RETURNED_HEAD_H_
#define RIPS_POLICY_SERVER_AUDIT_RETURNED_HEAD_H_

#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "policy_server/audit/segments.h"
#include "services/model/audit_head.h"

namespace rips::audit {

enum class HeadVerdict {
  // The log holds it.
  kHeld,
  // It is signed by its segment's key, and the log does not hold it: the log was put back to an
  // older state, or rewritten. An actuator cannot make such a head.
  kContradicted,
  // Its segment is not in the log, or has another key: the log was put back or replaced, or the
  // actuator lies.
  kUnknownSegment,
  // Its segment is older than the oldest of the log.
  kOlder,
  // It is not signed by its segment's key: the actuator lies, or its file was damaged.
  kForged,
};
inline constexpr HeadVerdict kHeadVerdicts[] = {HeadVerdict::kHeld, HeadVerdict::kContradicted,
                                                HeadVerdict::kUnknownSegment, HeadVerdict::kOlder,
                                                HeadVerdict::kForged};
// `held`, `contradicted`, `unknown_segment`, `older`, `forged`.
const char* ToString(HeadVerdict verdict);

// One verdict for each of `heads`, all whole and of `segment`. Reads that segment once, and only if
// a head of it is signed. An error is one of reading the files. Blocks on the disk.
absl::StatusOr<std::vector<HeadVerdict>> CompareHeads(const Segments& segments, uint64_t segment,
                                                      absl::Span<const model::AuditHead> heads);

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_AUDIT_RETURNED_HEAD_H_
