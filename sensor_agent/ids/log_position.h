// Where reading of a log has come to, and the text in which this outlives the process. Pure.
#ifndef RIPS_SENSOR_AGENT_IDS_LOG_POSITION_H_
#define RIPS_SENSOR_AGENT_IDS_LOG_POSITION_H_

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::sensor {

inline constexpr size_t kFingerprintBytes = 256;

struct LogPosition {
  uint64_t device = 0;
  // 0 = there was no file.
  uint64_t inode = 0;
  uint64_t offset = 0;
  // Of the up to kFingerprintBytes bytes before `offset`: an inode number alone is used again.
  uint64_t fingerprint = 0;

  friend bool operator==(const LogPosition&, const LogPosition&) = default;
};

// FNV-1a, 64 bits.
uint64_t Fingerprint(absl::string_view bytes);

// The content of the offsets file.
struct LogOffsets {
  // By path.
  std::map<std::string, LogPosition> logs;
  // Alerts before these positions that the server had not acknowledged.
  uint64_t unacknowledged = 0;

  friend bool operator==(const LogOffsets&, const LogOffsets&) = default;
};

// Lines of text, the last a checksum of those before:
//   rips ids-offsets 1
//   unacknowledged N
//   log DEVICE INODE OFFSET FINGERPRINT PATH
//   sum FINGERPRINT
// Numbers are decimal, fingerprints 16 hex digits; PATH is escaped as a C string.
std::string EncodeLogOffsets(const LogOffsets& offsets);
// Inverse of EncodeLogOffsets. DataLoss for anything else.
absl::StatusOr<LogOffsets> DecodeLogOffsets(absl::string_view text);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_IDS_LOG_POSITION_H_
