// What a server of the System Modes, lifecycle and parameter services receives and sends: the other
// half of services/ros2/system_modes_messages.h and parameter_messages.h. Decode* fail with DataLoss.
#ifndef RIPS_TESTS_SUPPORT_ROS2_SERVER_MESSAGES_H_
#define RIPS_TESTS_SUPPORT_ROS2_SERVER_MESSAGES_H_

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
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

}  // namespace rips::ros2

#endif  // RIPS_TESTS_SUPPORT_ROS2_SERVER_MESSAGES_H_
