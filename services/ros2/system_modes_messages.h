// What a client of the System Modes and lifecycle services (packages system_modes_msgs and
// lifecycle_msgs) sends and receives, as CDR payloads without a service header. Decode* fail with
// DataLoss. Requests without members carry one octet, as ROS sends them.
#ifndef RIPS_SERVICES_ROS2_SYSTEM_MODES_MESSAGES_H_
#define RIPS_SERVICES_ROS2_SYSTEM_MODES_MESSAGES_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::ros2 {

// Most strings accepted in one list of modes.
inline constexpr size_t kModesMax = 1'024;

// ROS service types, for dds::ServiceOptions::type.
inline constexpr char kChangeModeType[] = "system_modes_msgs/srv/ChangeMode";
inline constexpr char kGetModeType[] = "system_modes_msgs/srv/GetMode";
inline constexpr char kGetAvailableModesType[] = "system_modes_msgs/srv/GetAvailableModes";
inline constexpr char kChangeStateType[] = "lifecycle_msgs/srv/ChangeState";
inline constexpr char kGetStateType[] = "lifecycle_msgs/srv/GetState";

// Any request without members: GetMode, GetAvailableModes, GetState.
std::string EncodeEmptyRequest();

// ChangeMode: a mode name; the reply says "accepted", which is not "reached".
std::string EncodeChangeModeRequest(absl::string_view mode);
// The reply of ChangeMode and of ChangeState: one bool.
absl::StatusOr<bool> DecodeSuccessReply(absl::string_view payload);

// GetMode: the current mode; "unknown" or empty if the manager cannot infer it.
absl::StatusOr<std::string> DecodeGetModeReply(absl::string_view payload);

absl::StatusOr<std::vector<std::string>> DecodeGetAvailableModesReply(absl::string_view payload);

// lifecycle_msgs State and Transition: a number and a label. State ids: 1 unconfigured,
// 2 inactive, 3 active, 4 finalized. Transition ids: 1 configure, 2 cleanup, 3 activate,
// 4 deactivate. A server looks at the label only when it is not empty.
struct LifecycleLabel {
  uint8_t id = 0;
  std::string label;

  friend bool operator==(const LifecycleLabel&, const LifecycleLabel&) = default;
};

absl::StatusOr<LifecycleLabel> DecodeGetStateReply(absl::string_view payload);
std::string EncodeChangeStateRequest(const LifecycleLabel& transition);

}  // namespace rips::ros2

#endif  // RIPS_SERVICES_ROS2_SYSTEM_MODES_MESSAGES_H_
