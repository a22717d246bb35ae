#include "mode_actuator/system_modes.h"

#include <algorithm>
#include <optional>

#include "absl/container/btree_map.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/base/status_macros.h"
#include "services/dds/service_client.h"
#include "services/ros2/parameter_messages.h"
#include "services/ros2/system_modes_messages.h"

namespace rips::actuator {
namespace {

using dds::ServiceClient;

std::string Quote(absl::string_view text) {
  return absl::StrCat("`", absl::CHexEscape(text.substr(0, 100)), "`");
}

std::string StateName(uint8_t id) {
  switch (id) {
    case 0:
      return "unknown";
    case 1:
      return "unconfigured";
    case 2:
      return "inactive";
    case 3:
      return "active";
    case 4:
      return "finalized";
    default:
      return absl::StrCat("in transition (", id, ")");
  }
}

}  // namespace

// A part whose mode the manager is asked for.
struct SystemModes::Part {
  std::unique_ptr<ServiceClient> change_mode;
  std::unique_ptr<ServiceClient> get_mode;
  std::unique_ptr<ServiceClient> get_state;
  std::unique_ptr<ServiceClient> get_available_modes;
  std::vector<std::string> modes;  // that levels use
};

struct SystemModes::Node {
  std::unique_ptr<ServiceClient> get_state;
  std::unique_ptr<ServiceClient> get_parameters;
};

struct SystemModes::Target {
  std::vector<ExpectedPart> expected;
};

// What one look at the robot gave.
struct SystemModes::View {
  bool manager_agrees = false;
  bool manager_silent = false;
  std::string observed = "?";
  std::string manager_says;
  std::vector<std::string> wrong_parts;
};

class SystemModes::Impl {
 public:
  Impl(const dds::Participant* participant, Verify verify, const Clock* clock)
      : participant_(participant), verify_(verify), clock_(clock) {}

  absl::Status Add(const Smh& smh, const std::string& part, const std::string& mode);
  ModeReading Enter(absl::string_view part, absl::string_view mode, absl::Duration timeout,
                    int retries, const CancelFlag& cancel);
  ModeReading Check(absl::string_view part, absl::string_view mode, const CancelFlag& cancel);
  ModeReading Probe(absl::string_view part, absl::string_view mode, const CancelFlag& cancel);
  absl::Status CheckAvailable();

 private:
  absl::StatusOr<std::unique_ptr<ServiceClient>> Client(absl::string_view part,
                                                        absl::string_view service,
                                                        absl::string_view type) {
    return ServiceClient::Create(
        *participant_, {.service = absl::StrCat(part, "/", service), .type = std::string(type)});
  }
  absl::Status AddNode(const std::string& name);

  // A call that does not wait for a server that is not there.
  absl::StatusOr<std::string> Ask(ServiceClient& client, const std::string& request) {
    if (!client.ServerReady()) {
      return absl::UnavailableError(absl::StrCat(Quote(client.service()), " is not there"));
    }
    return client.Call(request, kReadTimeout);
  }
  absl::StatusOr<bool> Order(Part& part, absl::string_view mode, absl::Duration timeout);
  View Look(Part& part, absl::string_view mode, const Target& target, const CancelFlag& cancel);
  void AskManager(Part& part, absl::string_view mode, View& view);
  // Empty if the node is as expected, else what it is instead.
  std::string Judge(const ExpectedPart& expected);
  std::string JudgeParameters(Node& node, const ExpectedPart& expected);
  absl::Status Verdict(const View& view, bool silence_allowed) const;
  // One attempt, until `end_ns`.
  ModeReading Attempt(Part& part, absl::string_view mode, const Target& target, int64_t end_ns,
                      const CancelFlag& cancel);
  int64_t NowNs() const { return clock_->Now().boottime_ns; }

  const dds::Participant* const participant_;  // Not owned; outlives this.
  const Verify verify_;
  const Clock* const clock_;  // Not owned; outlives this.
  absl::btree_map<std::string, Part> parts_;
  absl::btree_map<std::string, Node> nodes_;
  absl::btree_map<std::pair<std::string, std::string>, Target> targets_;
};

absl::Status SystemModes::Impl::AddNode(const std::string& name) {
  if (nodes_.contains(name)) return absl::OkStatus();
  Node node;
  RIPS_ASSIGN_OR_RETURN(node.get_state, Client(name, "get_state", ros2::kGetStateType));
  RIPS_ASSIGN_OR_RETURN(node.get_parameters,
                        Client(name, "get_parameters", ros2::kGetParametersType));
  nodes_.emplace(name, std::move(node));
  return absl::OkStatus();
}

absl::Status SystemModes::Impl::Add(const Smh& smh, const std::string& part,
                                    const std::string& mode) {
  if (!parts_.contains(part)) {
    Part clients;
    RIPS_ASSIGN_OR_RETURN(clients.change_mode, Client(part, "change_mode", ros2::kChangeModeType));
    RIPS_ASSIGN_OR_RETURN(clients.get_mode, Client(part, "get_mode", ros2::kGetModeType));
    RIPS_ASSIGN_OR_RETURN(clients.get_state, Client(part, "get_state", ros2::kGetStateType));
    RIPS_ASSIGN_OR_RETURN(clients.get_available_modes,
                          Client(part, "get_available_modes", ros2::kGetAvailableModesType));
    parts_.emplace(part, std::move(clients));
  }
  Target target;
  RIPS_ASSIGN_OR_RETURN(target.expected, smh.Expected(part, mode));
  if (verify_ == Verify::kParts) {
    for (const ExpectedPart& node : target.expected) RIPS_RETURN_IF_ERROR(AddNode(node.node));
  }
  parts_.at(part).modes.push_back(mode);
  targets_[{part, mode}] = std::move(target);
  return absl::OkStatus();
}

absl::StatusOr<bool> SystemModes::Impl::Order(Part& part, absl::string_view mode,
                                              absl::Duration timeout) {
  RIPS_ASSIGN_OR_RETURN(const std::string reply,
                        part.change_mode->Call(ros2::EncodeChangeModeRequest(mode),
                                               std::min(timeout, kOrderTimeout)));
  return ros2::DecodeSuccessReply(reply);
}

void SystemModes::Impl::AskManager(Part& part, absl::string_view mode, View& view) {
  const absl::StatusOr<std::string> state_reply = Ask(*part.get_state, ros2::EncodeEmptyRequest());
  const absl::StatusOr<std::string> mode_reply = Ask(*part.get_mode, ros2::EncodeEmptyRequest());
  view.manager_silent = true;
  view.manager_says = "the mode manager does not answer";
  if (!state_reply.ok() || !mode_reply.ok()) return;
  const absl::StatusOr<ros2::LifecycleLabel> state = ros2::DecodeGetStateReply(*state_reply);
  const absl::StatusOr<std::string> now = ros2::DecodeGetModeReply(*mode_reply);
  view.manager_says = "the mode manager answers nonsense";
  if (!state.ok() || !now.ok()) return;
  view.manager_silent = state->id == 0 || now->empty() || *now == "unknown";
  if (!now->empty() && *now != "unknown") view.observed = absl::CHexEscape(now->substr(0, 64));
  view.manager_agrees = state->id == 3 && *now == mode;
  view.manager_says =
      absl::StrCat("the mode manager says ", Quote(*now), ", ", StateName(state->id));
}

std::string SystemModes::Impl::JudgeParameters(Node& node, const ExpectedPart& expected) {
  if (expected.parameters.empty()) return "";
  std::vector<std::string> names;
  for (const auto& [name, value] : expected.parameters) names.push_back(name);
  const absl::StatusOr<std::string> reply =
      Ask(*node.get_parameters, ros2::EncodeGetParametersRequest(names));
  if (!reply.ok()) return "does not tell its parameters";
  const auto values = ros2::DecodeGetParametersReply(*reply);
  if (!values.ok() || values->size() != names.size()) return "refuses to tell its parameters";
  for (size_t i = 0; i < names.size(); ++i) {
    const ros2::ParameterValue& wanted = expected.parameters.at(names[i]);
    if ((*values)[i] == wanted) continue;
    const std::string is = ros2::ToString((*values)[i]);
    return absl::StrCat("has `", names[i],
                        "` = ", absl::CHexEscape(absl::string_view(is).substr(0, 64)),
                        (*values)[i].index() == wanted.index() ? "" : " of another type",
                        ", expected ", ros2::ToString(wanted));
  }
  return "";
}

std::string SystemModes::Impl::Judge(const ExpectedPart& expected) {
  Node& node = nodes_.at(expected.node);
  const absl::StatusOr<std::string> reply = Ask(*node.get_state, ros2::EncodeEmptyRequest());
  if (!reply.ok()) return absl::StrCat(expected.node, " does not answer");
  const auto state = ros2::DecodeGetStateReply(*reply);
  if (!state.ok()) return absl::StrCat(expected.node, " answers nonsense");
  if (state->id != static_cast<uint8_t>(expected.state)) {
    return absl::StrCat(expected.node, " is ", StateName(state->id), ", expected ",
                        StateName(static_cast<uint8_t>(expected.state)));
  }
  const std::string parameters = JudgeParameters(node, expected);
  return parameters.empty() ? "" : absl::StrCat(expected.node, " ", parameters);
}

SystemModes::View SystemModes::Impl::Look(Part& part, absl::string_view mode, const Target& target,
                                          const CancelFlag& cancel) {
  View view;
  AskManager(part, mode, view);
  if (verify_ == Verify::kManager) return view;
  for (const ExpectedPart& expected : target.expected) {
    std::string wrong = cancel.cancelled() ? "not asked" : Judge(expected);
    if (!wrong.empty()) view.wrong_parts.push_back(std::move(wrong));
  }
  return view;
}

absl::Status SystemModes::Impl::Verdict(const View& view, bool silence_allowed) const {
  if (!view.wrong_parts.empty()) {
    const size_t shown = std::min(view.wrong_parts.size(), kDetailPartsMax);
    std::string detail =
        absl::StrJoin(view.wrong_parts.begin(), view.wrong_parts.begin() + shown, ", ");
    if (shown < view.wrong_parts.size()) {
      absl::StrAppend(&detail, " and ", view.wrong_parts.size() - shown, " more");
    }
    return absl::FailedPreconditionError(detail);
  }
  if (view.manager_agrees) return absl::OkStatus();
  if (verify_ == Verify::kParts && view.manager_silent && silence_allowed) return absl::OkStatus();
  return absl::FailedPreconditionError(view.manager_says);
}

ModeReading SystemModes::Impl::Attempt(Part& part, absl::string_view mode, const Target& target,
                                       int64_t end_ns, const CancelFlag& cancel) {
  ModeReading reading;
  reading.status = absl::DeadlineExceededError("no time left");
  bool ordered = false;
  int64_t taken_ns = 0;
  while (NowNs() < end_ns) {
    if (cancel.cancelled()) {
      reading.status = absl::CancelledError("cancelled");
      return reading;
    }
    if (!ordered) {
      const absl::StatusOr<bool> order = Order(part, mode, absl::Nanoseconds(end_ns - NowNs()));
      if (order.ok() && !*order) {
        reading.status = absl::InvalidArgumentError(absl::StrCat(
            "the mode manager refuses ", Quote(mode), "; does it run with the same SMH file?"));
        return reading;
      }
      ordered = order.ok();
      taken_ns = NowNs();
      if (!ordered) {
        reading.status = absl::UnavailableError(
            absl::StrCat("the order was not taken: ", order.status().message()));
      }
    }
    if (ordered) {
      const View view = Look(part, mode, target, cancel);
      reading.observed = view.observed;
      const bool silence_allowed = NowNs() - taken_ns >= absl::ToInt64Nanoseconds(kManagerSilence);
      const absl::Status verdict = Verdict(view, silence_allowed);
      if (verdict.ok()) {
        reading.status = verdict;
        if (view.observed == "?") reading.observed = absl::CHexEscape(mode);
        return reading;
      }
      reading.status = absl::DeadlineExceededError(
          absl::StrCat("ordered, but not reached: ", verdict.message()));
    }
    cancel.WaitFor(kReadPeriod);
  }
  return reading;
}

ModeReading SystemModes::Impl::Enter(absl::string_view part, absl::string_view mode,
                                     absl::Duration timeout, int retries,
                                     const CancelFlag& cancel) {
  ModeReading reading;
  const auto target = targets_.find({std::string(part), std::string(mode)});
  if (target == targets_.end()) {
    reading.status = absl::InvalidArgumentError("no target of any level");
    return reading;
  }
  for (int attempt = 0; attempt <= retries; ++attempt) {
    reading = Attempt(parts_.at(target->first.first), mode, target->second,
                      NowNs() + absl::ToInt64Nanoseconds(timeout), cancel);
    if (reading.status.ok() || absl::IsInvalidArgument(reading.status) ||
        absl::IsCancelled(reading.status)) {
      return reading;
    }
  }
  return reading;
}

ModeReading SystemModes::Impl::Check(absl::string_view part, absl::string_view mode,
                                     const CancelFlag& cancel) {
  ModeReading reading;
  const auto target = targets_.find({std::string(part), std::string(mode)});
  if (target == targets_.end()) {
    reading.status = absl::InvalidArgumentError("no target of any level");
    return reading;
  }
  const View view = Look(parts_.at(target->first.first), mode, target->second, cancel);
  reading.status = Verdict(view, /*silence_allowed=*/true);
  reading.observed = view.observed;
  if (reading.status.ok() && view.observed == "?") reading.observed = absl::CHexEscape(mode);
  return reading;
}

absl::Status SystemModes::Impl::CheckAvailable() {
  for (auto& [name, part] : parts_) {
    const absl::StatusOr<std::string> reply =
        Ask(*part.get_available_modes, ros2::EncodeEmptyRequest());
    if (!reply.ok()) {
      return absl::UnavailableError(absl::StrCat("no mode manager of ", Quote(name), " answers"));
    }
    RIPS_ASSIGN_OR_RETURN(const std::vector<std::string> available,
                          ros2::DecodeGetAvailableModesReply(*reply));
    for (const std::string& mode : part.modes) {
      if (std::find(available.begin(), available.end(), mode) != available.end()) continue;
      return absl::FailedPreconditionError(absl::StrCat("the mode manager of ", Quote(name),
                                                        " has no mode ", Quote(mode),
                                                        "; it runs with another SMH file"));
    }
  }
  return absl::OkStatus();
}

ModeReading SystemModes::Impl::Probe(absl::string_view part, absl::string_view mode,
                                     const CancelFlag& cancel) {
  ModeReading reading;
  const auto target = targets_.find(std::make_pair(std::string(part), std::string(mode)));
  if (target == targets_.end()) {
    reading.status = absl::InternalError("not a target");
    return reading;
  }
  Part& asked = parts_.at(target->first.first);
  const int64_t end_ns = NowNs() + absl::ToInt64Nanoseconds(kProbeTime);
  std::vector<std::string> silent;
  const absl::StatusOr<std::string> reply =
      Ask(*asked.get_available_modes, ros2::EncodeEmptyRequest());
  const auto available = reply.ok() ? ros2::DecodeGetAvailableModesReply(*reply) : reply.status();
  const bool managed = asked.change_mode->ServerReady() && available.ok();
  if (!managed) silent.push_back(absl::StrCat("no mode manager of ", Quote(part), " answers"));
  if (verify_ == Verify::kParts) {
    for (const ExpectedPart& expected : target->second.expected) {
      if (cancel.cancelled()) break;
      if (NowNs() >= end_ns) {
        silent.push_back(absl::StrCat(expected.node, " was not asked for want of time"));
        continue;
      }
      const absl::StatusOr<std::string> state =
          Ask(*nodes_.at(expected.node).get_state, ros2::EncodeEmptyRequest());
      if (state.ok() && ros2::DecodeGetStateReply(*state).ok()) continue;
      silent.push_back(absl::StrCat(expected.node, " does not answer"));
    }
  }
  if (cancel.cancelled()) {
    reading.status = absl::CancelledError("cancelled");
  } else if (!silent.empty()) {
    const size_t shown = std::min(silent.size(), kDetailPartsMax);
    std::string why = absl::StrJoin(silent.begin(), silent.begin() + shown, ", ");
    if (shown < silent.size()) absl::StrAppend(&why, " and ", silent.size() - shown, " more");
    reading.status = absl::UnavailableError(why);
  } else if (std::find(available->begin(), available->end(), mode) == available->end()) {
    reading.status = absl::FailedPreconditionError(absl::StrCat("the mode manager of ", Quote(part),
                                                                " has no mode ", Quote(mode),
                                                                "; it runs with another SMH file"));
  }
  if (managed) {
    View view;
    AskManager(asked, mode, view);
    reading.observed = view.observed;
  }
  return reading;
}

SystemModes::SystemModes(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
SystemModes::~SystemModes() = default;

absl::StatusOr<std::unique_ptr<SystemModes>> SystemModes::Create(
    const dds::Participant* participant, const Smh& smh, Verify verify, const Targets& targets,
    const Clock* clock) {
  auto impl = std::make_unique<Impl>(participant, verify, clock);
  for (const auto& [part, mode] : targets) RIPS_RETURN_IF_ERROR(impl->Add(smh, part, mode));
  return std::unique_ptr<SystemModes>(new SystemModes(std::move(impl)));
}

ModeReading SystemModes::Enter(absl::string_view part, absl::string_view mode,
                               absl::Duration timeout, int retries, const CancelFlag& cancel) {
  return impl_->Enter(part, mode, timeout, retries, cancel);
}

ModeReading SystemModes::Check(absl::string_view part, absl::string_view mode,
                               const CancelFlag& cancel) {
  return impl_->Check(part, mode, cancel);
}

ModeReading SystemModes::Probe(absl::string_view part, absl::string_view mode,
                               const CancelFlag& cancel) {
  return impl_->Probe(part, mode, cancel);
}

absl::Status SystemModes::CheckAvailable() { return impl_->CheckAvailable(); }

}  // namespace rips::actuator
