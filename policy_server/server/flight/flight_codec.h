// A flight as a recording: bytes in the format of policy/recording/FORMAT.md.
#ifndef RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_CODEC_H_
#define RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_CODEC_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/policy/recording/recorded.h"
#include "policy_server/server/flight/flight_ring.h"

namespace rips::flight {

// What a recording of that flight says of itself. `alerts`: those that it is saved with.
recording::RecordedOrigin OriginOf(const std::string& robot, const Flight& flight,
                                   std::vector<recording::RecordedAlert> alerts);

// An event that no recording can hold, as one with a text that is not UTF-8, keeps its place and is
// not judged. Errors as RipsWriter::Append of the header.
absl::StatusOr<std::string> EncodeFlight(const recording::RecordedOrigin& origin,
                                         const Flight& flight);

}  // namespace rips::flight

#endif  // RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_CODEC_H_
