// What a server of the System Modes, lifecycle and parameter services receives and sends: the other
// half of services/ros2/system_modes_messages.h and parameter_messages.h. Decode* fail with
// DataLoss. And whether a claim of ros_discovery_info is of its own participant.
#ifndef RIPS_TESTS_SUPPORT_ROS2_SERVER_MESSAGES_H_
#define RIPS_TESTS_SUPPORT_ROS2_SERVER_MESSAGES_H_

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/guid.h"
#include "services/ros2/parameter_messages.h"
#include "services/ros2/system_modes_messages.h"

namespace rips::ros2 {

absl::Status DecodeEmptyRequest(absl::string_view payload);

absl::StatusOr<std::string> DecodeChangeModeRequest(absl::string_view payload);
std::string EncodeSuccessReply(bool success);
std::string EncodeGetModeReply(absl::string_view mode);
std::string EncodeGetAvailableModesReply(const std::vector<std::string>& modes);

std::string EncodeGetStateReply(const LifecycleLabel& state);
absl::StatusOr<LifecycleLabel> DecodeChangeStateRequest(absl::string_view payload);

absl::StatusOr<std::vector<std::string>> DecodeGetParametersRequest(absl::string_view payload);
// One value per requested name, in that order; a node answers with an empty list if it refuses.
std::string EncodeGetParametersReply(const std::vector<ParameterValue>& values);
absl::StatusOr<std::vector<NamedParameter>> DecodeSetParametersRequest(absl::string_view payload);
std::string EncodeSetParametersReply(const SetParametersResult& result);

// OK if `writer`, the endpoint that published `info`, belongs to the participant that `info`
// speaks for, and so does every endpoint listed. PermissionDenied otherwise: the claim is for
// another participant.
absl::Status CheckOrigin(const ParticipantEntities& info, const Guid& writer);

}  // namespace rips::ros2

#endif  // RIPS_TESTS_SUPPORT_ROS2_SERVER_MESSAGES_H_
