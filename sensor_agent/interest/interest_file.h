// The interest as it stands on the wire and, for the time until the policy server is heard again
// after a start, on the disk.
//
// The file `interest` of the state directory is a serialized rips.v1.Interest as the server sent
// it. Its id is its checksum.
#ifndef RIPS_SENSOR_AGENT_INTEREST_INTEREST_FILE_H_
#define RIPS_SENSOR_AGENT_INTEREST_INTEREST_FILE_H_

#include <cstddef>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "rips/v1/sensor.pb.h"
#include "sensor_agent/interest/interest.h"

namespace rips::sensor {

// gRPC takes no larger message.
inline constexpr size_t kInterestFileBytesMax = size_t{4} << 20;

std::string InterestFile(const std::string& state_dir);

// InvalidArgument: a depth that is not known, or as Interest::Create.
absl::StatusOr<std::shared_ptr<const Interest>> InterestFromWire(const rips::v1::Interest& wire);

// SHA-256 of `interest` without its id, 32 bytes.
std::string InterestId(rips::v1::Interest interest);

// Replaces the file whole; on the disk when it returns OK.
absl::Status SaveInterest(const std::string& path, const rips::v1::Interest& interest);

// NotFound if there is no file; DataLoss if it is not what SaveInterest wrote of an interest whose
// id is its checksum; else as ReadFile and InterestFromWire.
absl::StatusOr<std::shared_ptr<const Interest>> LoadInterest(const std::string& path);

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_INTEREST_INTEREST_FILE_H_
