#include "mode_actuator/steps/system_mode/node_client.h"

#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/ros2/parameter_messages.h"
#include "services/ros2/ros_name.h"
#include "services/ros2/system_modes_messages.h"

namespace rips::actuator {
namespace {

using dds::ServiceClient;

constexpr size_t kValueBytesShown = 64;
constexpr size_t kReasonBytesShown = 100;

absl::StatusOr<std::unique_ptr<ServiceClient>> Client(const dds::Participant& participant,
                                                      const std::string& node,
                                                      absl::string_view service,
                                                      absl::string_view type) {
  return ServiceClient::Create(
      participant, {.service = absl::StrCat(node, "/", service), .type = std::string(type)});
}

absl::string_view TransitionName(uint8_t transition) {
  switch (transition) {
    case kTransitionConfigure:
      return "configure";
    case kTransitionActivate:
      return "activate";
    default:
      return "deactivate";
  }
}

}  // namespace

std::string StateName(uint8_t id) {
  switch (id) {
    case 0:
      return "unknown";
    case kStateUnconfigured:
      return "unconfigured";
    case 2:
      return "inactive";
    case 3:
      return "active";
    case kStateFinalized:
      return "finalized";
    default:
      return absl::StrCat("in transition (", id, ")");
  }
}

uint8_t NextTransition(uint8_t state, PartState wanted) {
  if (state == static_cast<uint8_t>(wanted)) return 0;
  if (state == kStateUnconfigured) return kTransitionConfigure;
  if (state == static_cast<uint8_t>(PartState::kInactive)) return kTransitionActivate;
  if (state == static_cast<uint8_t>(PartState::kActive)) return kTransitionDeactivate;
  return 0;
}

absl::StatusOr<std::string> AskIfThere(ServiceClient& client, const std::string& request,
                                       absl::Duration timeout, dds::IfSeveral if_several) {
  if (!client.ServerReady()) {
    return absl::UnavailableError(absl::StrCat("`", client.service(), "` is not there"));
  }
  return client.Call(request, timeout, if_several);
}

absl::StatusOr<std::unique_ptr<NodeClient>> NodeClient::Create(const dds::Participant& participant,
                                                               const std::string& name) {
  std::unique_ptr<NodeClient> node(new NodeClient(name));
  RIPS_ASSIGN_OR_RETURN(node->get_state_,
                        Client(participant, name, "get_state", ros2::kGetStateType));
  RIPS_ASSIGN_OR_RETURN(node->get_parameters_,
                        Client(participant, name, "get_parameters", ros2::kGetParametersType));
  RIPS_ASSIGN_OR_RETURN(node->change_state_,
                        Client(participant, name, "change_state", ros2::kChangeStateType));
  RIPS_ASSIGN_OR_RETURN(
      node->set_parameters_,
      Client(participant, name, "set_parameters_atomically", ros2::kSetParametersAtomicallyType));
  return node;
}

void NodeClient::SuspectAll() {
  for (ServiceClient* each :
       {get_state_.get(), get_parameters_.get(), change_state_.get(), set_parameters_.get()}) {
    each->Suspect();
  }
}

absl::StatusOr<uint8_t> NodeClient::State(absl::Duration timeout) {
  const absl::StatusOr<std::string> reply =
      AskIfThere(*get_state_, ros2::EncodeEmptyRequest(), timeout);
  if (absl::IsDeadlineExceeded(reply.status())) SuspectAll();
  RIPS_RETURN_IF_ERROR(reply.status());
  RIPS_ASSIGN_OR_RETURN(const ros2::LifecycleLabel state, ros2::DecodeGetStateReply(*reply));
  return state.id;
}

void NodeClient::JudgeParameters(const ExpectedPart& expected, absl::Duration timeout,
                                 NodeView& view) {
  view.complete = true;
  if (expected.parameters.empty()) return;
  std::vector<std::string> names;
  for (const auto& [name, value] : expected.parameters) names.push_back(name);
  const absl::StatusOr<std::string> reply =
      AskIfThere(*get_parameters_, ros2::EncodeGetParametersRequest(names), timeout);
  view.complete = reply.ok();
  if (!reply.ok()) {
    view.ambiguous = absl::IsFailedPrecondition(reply.status());
    view.wrong = view.ambiguous ? std::string(reply.status().message())
                                : absl::StrCat(name_, " does not report its parameters");
    return;
  }
  const auto values = ros2::DecodeGetParametersReply(*reply);
  if (!values.ok() || values->size() != names.size()) {
    view.wrong = absl::StrCat(name_, " refuses to report its parameters");
    return;
  }
  for (size_t i = 0; i < names.size(); ++i) {
    const ros2::ParameterValue& wanted = expected.parameters.at(names[i]);
    if ((*values)[i] == wanted) continue;
    const std::string is = ros2::ToString((*values)[i]);
    view.wrong =
        absl::StrCat(name_, " has `", names[i],
                     "` = ", ros2::Printable(absl::string_view(is).substr(0, kValueBytesShown)),
                     (*values)[i].index() == wanted.index() ? "" : " of another type",
                     ", expected ", ros2::ToString(wanted));
    return;
  }
}

NodeView NodeClient::Poll(const ExpectedPart& expected, absl::Duration timeout) {
  NodeView view;
  const absl::StatusOr<uint8_t> state = State(timeout);
  view.ambiguous = absl::IsFailedPrecondition(state.status());
  if (view.ambiguous) {
    view.wrong = std::string(state.status().message());
    return view;
  }
  if (!state.ok()) {
    view.wrong = absl::StrCat(
        name_, absl::IsDataLoss(state.status()) ? " sent an invalid answer" : " does not answer");
    return view;
  }
  view.answers = true;
  view.state = *state;
  view.state_ok = *state == static_cast<uint8_t>(expected.state);
  if (view.state_ok) {
    JudgeParameters(expected, timeout, view);
    return view;
  }
  view.complete = true;
  view.wrong = absl::StrCat(name_, " is ", StateName(*state), ", expected ",
                            StateName(static_cast<uint8_t>(expected.state)));
  return view;
}

absl::Status NodeClient::Transition(uint8_t transition) {
  RIPS_ASSIGN_OR_RETURN(
      const std::string reply,
      AskIfThere(*change_state_, ros2::EncodeChangeStateRequest({.id = transition, .label = ""}),
                 kNodeOrderTimeout, dds::IfSeveral::kSendToAll));
  RIPS_ASSIGN_OR_RETURN(const bool success, ros2::DecodeSuccessReply(reply));
  if (success) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(name_, " failed to ", TransitionName(transition)));
}

absl::Status NodeClient::SetParameters(const ParameterMap& parameters) {
  std::vector<ros2::NamedParameter> list;
  for (const auto& [name, value] : parameters) list.push_back({name, value});
  RIPS_ASSIGN_OR_RETURN(const std::string reply,
                        AskIfThere(*set_parameters_, ros2::EncodeSetParametersRequest(list),
                                   kNodeOrderTimeout, dds::IfSeveral::kSendToAll));
  RIPS_ASSIGN_OR_RETURN(const ros2::SetParametersResult result,
                        ros2::DecodeSetParametersReply(reply));
  if (result.successful) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(name_, " refuses parameters: ",
                   ros2::Printable(absl::string_view(result.reason).substr(0, kReasonBytesShown))));
}

}  // namespace rips::actuator
