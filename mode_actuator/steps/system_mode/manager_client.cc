#include "mode_actuator/steps/system_mode/manager_client.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"
#include "services/ros2/system_modes_messages.h"

namespace rips::actuator {
namespace {

constexpr size_t kModeBytesShown = 64;
constexpr uint8_t kUnknown = 0;
constexpr uint8_t kActive = 3;

}  // namespace

absl::StatusOr<std::unique_ptr<ManagerClient>> ManagerClient::Create(
    const dds::Participant& participant, const std::string& part) {
  const auto client = [&](absl::string_view service, absl::string_view type) {
    return dds::ServiceClient::Create(
        participant, {.service = absl::StrCat(part, "/", service), .type = std::string(type)});
  };
  std::unique_ptr<ManagerClient> manager(new ManagerClient);
  RIPS_ASSIGN_OR_RETURN(manager->change_mode_, client("change_mode", ros2::kChangeModeType));
  RIPS_ASSIGN_OR_RETURN(manager->get_mode_, client("get_mode", ros2::kGetModeType));
  RIPS_ASSIGN_OR_RETURN(manager->get_state_, client("get_state", ros2::kGetStateType));
  RIPS_ASSIGN_OR_RETURN(manager->get_available_modes_,
                        client("get_available_modes", ros2::kGetAvailableModesType));
  return manager;
}

absl::StatusOr<bool> ManagerClient::Order(absl::string_view mode, absl::Duration timeout) {
  RIPS_ASSIGN_OR_RETURN(
      const std::string reply,
      change_mode_->Call(ros2::EncodeChangeModeRequest(mode), std::min(timeout, kOrderTimeout),
                         dds::IfSeveral::kSendToAll));
  return ros2::DecodeSuccessReply(reply);
}

absl::StatusOr<bool> ManagerClient::OrderIfThere(absl::string_view mode) {
  RIPS_ASSIGN_OR_RETURN(const std::string reply,
                        AskIfThere(*change_mode_, ros2::EncodeChangeModeRequest(mode), kReadTimeout,
                                   dds::IfSeveral::kSendToAll));
  return ros2::DecodeSuccessReply(reply);
}

ManagerView ManagerClient::Poll(absl::string_view mode, absl::Duration timeout) {
  ManagerView view;
  const absl::StatusOr<std::string> state_reply =
      AskIfThere(*get_state_, ros2::EncodeEmptyRequest(), timeout);
  const absl::StatusOr<std::string> mode_reply =
      state_reply.ok() ? AskIfThere(*get_mode_, ros2::EncodeEmptyRequest(), timeout) : state_reply;
  if (absl::IsFailedPrecondition(mode_reply.status())) {
    view.says = std::string(mode_reply.status().message());
  }
  if (!mode_reply.ok()) return view;
  const absl::StatusOr<ros2::LifecycleLabel> state = ros2::DecodeGetStateReply(*state_reply);
  const absl::StatusOr<std::string> now = ros2::DecodeGetModeReply(*mode_reply);
  view.says = "the mode manager sent an invalid answer";
  if (!state.ok() || !now.ok()) return view;
  view.answers = true;
  const bool named = !now->empty() && *now != "unknown";
  const std::string shown = ros2::Printable(absl::string_view(*now).substr(0, kModeBytesShown));
  view.silent = state->id == kUnknown || !named || *now == mode;
  if (named) {
    view.named = *now;
    view.observed = shown;
  }
  view.agrees = state->id == kActive && *now == mode;
  view.elsewhere = state->id == kActive && named && *now != mode;
  view.says = absl::StrCat("the mode manager says `", shown, "`, ", StateName(state->id));
  return view;
}

absl::StatusOr<std::vector<std::string>> ManagerClient::AvailableModes() {
  RIPS_ASSIGN_OR_RETURN(const std::string reply,
                        AskIfThere(*get_available_modes_, ros2::EncodeEmptyRequest()));
  return ros2::DecodeGetAvailableModesReply(reply);
}

std::optional<ros2::Guid> ManagerClient::server() const { return change_mode_->Server(); }

}  // namespace rips::actuator
