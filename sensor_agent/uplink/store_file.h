// What the policy server's store held by the last that this sensor was told, for the hello of the
// next process: a server whose store was restored from a backup is recognised by it.
//
// The file `store` of the state directory is one line: `rips-store 1`, the generation as 32 hex
// digits, the commit, and the CRC-32C of all that as 8 hex digits.
#ifndef RIPS_SENSOR_AGENT_UPLINK_STORE_FILE_H_
#define RIPS_SENSOR_AGENT_UPLINK_STORE_FILE_H_

#include <cstddef>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "rips/v1/session.pb.h"

namespace rips::sensor {

inline constexpr size_t kGenerationBytes = 16;

std::string StoreFile(const std::string& state_dir);

// Replaces the file whole; on the disk when it returns OK. InvalidArgument: the generation has not
// kGenerationBytes.
absl::Status SaveStorePoint(const std::string& path, const rips::v1::StorePoint& point);

// NotFound if there is no file; DataLoss if it is not what SaveStorePoint wrote; else as ReadFile.
absl::StatusOr<rips::v1::StorePoint> LoadStorePoint(const std::string& path);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_STORE_FILE_H_
