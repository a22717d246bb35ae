// The end of a server's audit log at some time, as its actuators keep it: what the log must still
// hold when they come back. The audit log's FORMAT.md says what it proves.
#ifndef RIPS_SERVICES_MODEL_AUDIT_HEAD_H_
#define RIPS_SERVICES_MODEL_AUDIT_HEAD_H_

#include <cstddef>
#include <cstdint>
#include <string>

namespace rips::model {

struct AuditHead {
  static constexpr size_t kKeyBytes = 32;
  static constexpr size_t kHashBytes = 32;
  static constexpr size_t kSignatureBytes = 64;
  // Of a segment and a sequence; more is not sent.
  static constexpr uint64_t kNumberMax = uint64_t{1} << 62;

  // From 1; 0 = none.
  uint64_t segment = 0;
  // Ed25519, of the segment.
  std::string public_key;
  // Of the newest record that is durable, and its hash.
  uint64_t sequence = 0;
  std::string hash;
  // Of the seal behind that record, by the segment's key.
  std::string signature;

  bool none() const { return segment == 0; }
  // Neither none nor a part missing.
  bool whole() const {
    return segment != 0 && segment <= kNumberMax && sequence != 0 && sequence <= kNumberMax &&
           public_key.size() == kKeyBytes && hash.size() == kHashBytes &&
           signature.size() == kSignatureBytes;
  }
  friend bool operator==(const AuditHead&, const AuditHead&) = default;
};

}  // namespace rips::model

#endif  // RIPS_SERVICES_MODEL_AUDIT_HEAD_H_
