#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "services/dds/service_client.h"
#include "services/ros2/parameter_messages.h"
#include "services/ros2/system_modes_messages.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/commands.h"
#include "tests/support/robot_sim/events.h"

namespace rips::robot_sim {
namespace {

using Json = nlohmann::ordered_json;

constexpr absl::Duration kPollPeriod = absl::Milliseconds(20);

absl::StatusOr<std::unique_ptr<dds::ServiceClient>> Client(const dds::Participant& participant,
                                                           const std::string& part,
                                                           absl::string_view name,
                                                           absl::string_view type) {
  return dds::ServiceClient::Create(
      participant, {.service = absl::StrCat(part, name), .type = std::string(type)});
}

// One call of a service that is not kept.
absl::StatusOr<std::string> CallOnce(const dds::Participant& participant,
                                     const ModeCommand& command, const std::string& part,
                                     absl::string_view name, absl::string_view type,
                                     absl::string_view request) {
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<dds::ServiceClient> client,
                        Client(participant, part, name, type));
  return client->Call(request, command.timeout);
}

absl::StatusOr<std::string> State(const dds::Participant& participant, const ModeCommand& command,
                                  const std::string& part) {
  RIPS_ASSIGN_OR_RETURN(const std::string reply,
                        CallOnce(participant, command, part, "/get_state", ros2::kGetStateType,
                                 ros2::EncodeEmptyRequest()));
  RIPS_ASSIGN_OR_RETURN(const ros2::LifecycleLabel state, ros2::DecodeGetStateReply(reply));
  return state.label;
}

absl::StatusOr<Json> Parameters(const dds::Participant& participant, const ModeCommand& command,
                                const std::string& part, const std::vector<std::string>& names) {
  RIPS_ASSIGN_OR_RETURN(
      const std::string reply,
      CallOnce(participant, command, part, "/get_parameters", ros2::kGetParametersType,
               ros2::EncodeGetParametersRequest(names)));
  RIPS_ASSIGN_OR_RETURN(const std::vector<ros2::ParameterValue> values,
                        ros2::DecodeGetParametersReply(reply));
  Json parameters = Json::object();
  for (size_t i = 0; i < values.size() && i < names.size(); ++i) {
    parameters[names[i]] = ros2::ToString(values[i]);
  }
  return parameters;
}

// The nodes that `__DEFAULT__` of the part covers, read back one by one.
absl::StatusOr<Json> Parts(const dds::Participant& participant, const ModeCommand& command) {
  Json parts = Json::array();
  if (command.smh_file.empty()) {
    return parts;
  }
  RIPS_ASSIGN_OR_RETURN(const std::string text, ReadFile(command.smh_file));
  RIPS_ASSIGN_OR_RETURN(const actuator::Smh smh, actuator::ParseSmh(text, command.smh_file));
  RIPS_ASSIGN_OR_RETURN(const std::vector<actuator::ExpectedPart> expected,
                        smh.Expected(command.part, actuator::kDefaultMode));
  for (const actuator::ExpectedPart& part : expected) {
    RIPS_ASSIGN_OR_RETURN(const std::string state, State(participant, command, part.node));
    std::vector<std::string> names;
    for (const auto& [name, unused] : part.parameters) {
      names.push_back(name);
    }
    RIPS_ASSIGN_OR_RETURN(const Json parameters,
                          Parameters(participant, command, part.node, names));
    parts.push_back({{"part", part.node}, {"state", state}, {"parameters", parameters}});
  }
  return parts;
}

}  // namespace

absl::Status RunMode(const ModeCommand& command, StopFlag& stop) {
  RIPS_ASSIGN_OR_RETURN(const dds::ParticipantOptions identity, Identity(command.security));
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<dds::Participant> participant,
                        dds::Participant::Create(command.domain, identity));
  RIPS_ASSIGN_OR_RETURN(const std::string mode_reply,
                        CallOnce(*participant, command, command.part, "/get_mode",
                                 ros2::kGetModeType, ros2::EncodeEmptyRequest()));
  RIPS_ASSIGN_OR_RETURN(const std::string mode, ros2::DecodeGetModeReply(mode_reply));
  RIPS_ASSIGN_OR_RETURN(const std::string modes_reply,
                        CallOnce(*participant, command, command.part, "/get_available_modes",
                                 ros2::kGetAvailableModesType, ros2::EncodeEmptyRequest()));
  RIPS_ASSIGN_OR_RETURN(const std::vector<std::string> available,
                        ros2::DecodeGetAvailableModesReply(modes_reply));
  RIPS_ASSIGN_OR_RETURN(const std::string state, State(*participant, command, command.part));
  RIPS_ASSIGN_OR_RETURN(const Json parts, Parts(*participant, command));
  if (stop.WaitFor(absl::ZeroDuration())) {
    return absl::CancelledError("stopped");
  }
  PrintEvent({{"event", "mode_of"},
              {"part", command.part},
              {"mode", mode},
              {"state", state},
              {"available", available},
              {"parts", parts},
              {"unix_ns", RealClock().Now().unix_ns}});
  return absl::OkStatus();
}

absl::Status RunSetMode(const ModeCommand& command, StopFlag& stop) {
  const RealClock clock;
  RIPS_ASSIGN_OR_RETURN(const dds::ParticipantOptions identity, Identity(command.security));
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<dds::Participant> participant,
                        dds::Participant::Create(command.domain, identity));
  RIPS_ASSIGN_OR_RETURN(
      const std::string reply,
      CallOnce(*participant, command, command.part, "/change_mode", ros2::kChangeModeType,
               ros2::EncodeChangeModeRequest(command.mode)));
  RIPS_ASSIGN_OR_RETURN(const bool success, ros2::DecodeSuccessReply(reply));
  PrintEvent({{"event", "set_mode"},
              {"part", command.part},
              {"mode", command.mode},
              {"success", success},
              {"unix_ns", clock.Now().unix_ns}});
  if (!success) {
    return absl::FailedPreconditionError(
        absl::StrCat("`", command.part, "` refused mode `", command.mode, "`"));
  }
  if (command.wait == absl::ZeroDuration()) {
    return absl::OkStatus();
  }
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<dds::ServiceClient> get_mode,
                        Client(*participant, command.part, "/get_mode", ros2::kGetModeType));
  const int64_t deadline_ns = clock.Now().boottime_ns + absl::ToInt64Nanoseconds(command.wait);
  std::string mode;
  while (mode != command.mode) {
    if (clock.Now().boottime_ns > deadline_ns || stop.WaitFor(kPollPeriod)) {
      return absl::DeadlineExceededError(
          absl::StrCat("`", command.part, "` is in mode `", mode, "`, not `", command.mode, "`"));
    }
    RIPS_ASSIGN_OR_RETURN(const std::string answer,
                          get_mode->Call(ros2::EncodeEmptyRequest(), command.timeout));
    RIPS_ASSIGN_OR_RETURN(mode, ros2::DecodeGetModeReply(answer));
  }
  PrintEvent({{"event", "reached"},
              {"part", command.part},
              {"mode", mode},
              {"unix_ns", clock.Now().unix_ns}});
  return absl::OkStatus();
}

}  // namespace rips::robot_sim
