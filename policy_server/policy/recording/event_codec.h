// Events between memory and rips.v1.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_EVENT_CODEC_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_EVENT_CODEC_H_

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/recording/recorded.h"
#include "rips/v1/recording.pb.h"

namespace rips::recording {

// InvalidArgument: a GUID that is not 16 bytes, an endpoint without a kind, what CheckSize
// refuses. What a newer version writes and this one does not
// know becomes RecordedOther. The index stays 0.
absl::StatusOr<Recorded> DecodeEvent(const rips::v1::RecordedEvent& wire);
RecordedOrigin DecodeHeader(const rips::v1::RecordingHeader& wire);

// InvalidArgument: a payload longer than its size, or shorter without being truncated.
absl::Status CheckSize(const RecordedMessage& message);

// The index is not kept.
rips::v1::RecordedEvent EncodeEvent(const Recorded& event);
rips::v1::RecordingHeader EncodeHeader(const RecordedOrigin& origin);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_EVENT_CODEC_H_
