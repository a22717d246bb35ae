// Keeps the newest head of the server's audit log that this actuator was shown, across restarts:
// a server whose log was put back is contradicted by what its actuators say hello with.
//
// On disk:  rips-actuator-audit-head 1
//           segment 3
//           key <64 hex digits>
//           sequence 812
//           hash <64 hex digits>
//           signature <128 hex digits>
//           crc <8 hex digits, CRC-32 of all before>
//
// Pure; one thread at a time.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_AUDIT_HEAD_KEEPER_H_
#define RIPS_MODE_ACTUATOR_DECIDE_AUDIT_HEAD_KEEPER_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/base/clock.h"
#include "services/model/audit_head.h"

namespace rips::actuator {

inline constexpr size_t kAuditHeadBytesMax = 1024;

// Of a head that is whole.
std::string EncodeAuditHead(const model::AuditHead& head);
// Inverse. DataLoss for anything EncodeAuditHead does not give, byte for byte.
absl::StatusOr<model::AuditHead> DecodeAuditHead(absl::string_view bytes);

class AuditHeadKeeper {
 public:
  // Between two writes.
  static constexpr int64_t kWriteNs = 10 * kNanosPerSecond;

  // What was kept; none at first.
  explicit AuditHeadKeeper(model::AuditHead kept = {}) : head_(std::move(kept)) {}

  // Keeps the head of a lease. Returns a text for the journal if the head is behind the previous
  // one or of another log: the server's log was put back or replaced. Empty otherwise.
  std::string OnLease(const model::AuditHead& head);
  // What to write now, if it is time.
  std::optional<std::string> TakeWrite(int64_t boottime_ns);

  const model::AuditHead& head() const { return head_; }

 private:
  model::AuditHead head_;
  bool changed_ = false;
  std::optional<int64_t> written_ns_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_AUDIT_HEAD_KEEPER_H_
