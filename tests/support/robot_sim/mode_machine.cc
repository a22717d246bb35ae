#include "tests/support/robot_sim/mode_machine.h"

#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace rips::robot_sim {

using actuator::kDefaultMode;
using actuator::PartState;
using actuator::PartTarget;

absl::string_view Label(Lifecycle state) {
  switch (state) {
    case Lifecycle::kUnknown:
      return "unknown";
    case Lifecycle::kUnconfigured:
      return "unconfigured";
    case Lifecycle::kInactive:
      return "inactive";
    case Lifecycle::kActive:
      return "active";
    case Lifecycle::kActivating:
      return "activating";
  }
  return "unknown";
}

ModeMachine::ModeMachine(actuator::Smh smh, ModeMachineOptions options)
    : smh_(std::move(smh)), options_(std::move(options)), target_(kDefaultMode) {}

absl::StatusOr<ModeMachine> ModeMachine::Create(actuator::Smh smh, ModeMachineOptions options) {
  const auto system = smh.systems.find(options.system);
  if (system == smh.systems.end()) {
    return absl::NotFoundError(absl::StrCat("no system `", options.system, "` in the file"));
  }
  for (const std::string& part : system->second.parts) {
    if (!smh.nodes.contains(part)) {
      return absl::InvalidArgumentError(
          absl::StrCat("part `", part, "` is not a node; only systems of nodes are simulated"));
    }
  }
  ModeMachine machine(std::move(smh), std::move(options));
  machine.Apply(machine.system(), kDefaultMode);
  return machine;
}

bool ModeMachine::ChangeMode(absl::string_view part, absl::string_view mode, int64_t now_ns) {
  if (options_.conduct == ManagerConduct::kRefuse) {
    return false;
  }
  bool known = false;
  for (const std::string& available : AvailableModes(part)) {
    known = known || available == mode;
  }
  if (!known) {
    return false;
  }
  if (options_.conduct == ManagerConduct::kLie || options_.conduct == ManagerConduct::kDeceive) {
    claimed_ = part == options_.system ? std::string(mode) : claimed_;
    return true;
  }
  if (Mode(part) != mode) {
    pending_[std::string(part)] = {std::string(mode), now_ns + options_.transition_ns};
  }
  return true;
}

bool ModeMachine::ChangeState(absl::string_view node, uint8_t transition) {
  const auto it = nodes_.find(node);
  if (it == nodes_.end()) {
    return false;
  }
  NodeState& state = it->second;
  const bool inactive = state.configured && !state.active;
  const bool possible = (transition == kTransitionConfigure && !state.configured) ||
                        (transition == kTransitionCleanup && inactive) ||
                        (transition == kTransitionActivate && inactive) ||
                        (transition == kTransitionDeactivate && state.active);
  if (!possible || state.stuck) {
    return false;
  }
  state.configured = transition != kTransitionCleanup;
  state.active = transition == kTransitionActivate;
  not_inferred_.erase(it->first);
  return true;
}

std::string ModeMachine::SetParameters(absl::string_view node,
                                       const actuator::ParameterMap& parameters) {
  const auto it = nodes_.find(node);
  if (it == nodes_.end() || it->second.stuck) {
    return "not now";
  }
  NodeState& state = it->second;
  for (const auto& [name, value] : parameters) {
    const auto declared = state.parameters.find(name);
    if (declared == state.parameters.end()) {
      return absl::StrCat("parameter '", name, "' has not been declared");
    }
    if (declared->second.index() != value.index()) {
      return absl::StrCat("wrong parameter type of '", name, "'");
    }
  }
  for (const auto& [name, value] : parameters) {
    state.parameters[name] = value;
  }
  state.mode.clear();
  for (const auto& [mode, wanted] : smh_.nodes.find(node)->second.modes) {
    if (wanted == state.parameters) {
      state.mode = mode;
    }
  }
  return "";
}

void ModeMachine::SetPull(absl::string_view from, absl::string_view to) {
  options_.conduct = ManagerConduct::kPull;
  options_.pull_from = std::string(from);
  options_.pull_to = std::string(to);
}

void ModeMachine::Unconfigure(absl::string_view node) {
  NodeState& state = nodes_.at(std::string(node));
  state.active = false;
  state.configured = false;
}

void ModeMachine::ForgetModes() {
  pending_.clear();
  target_.clear();
  claimed_.clear();
  for (const auto& [node, unused] : nodes_) {
    not_inferred_.insert(node);
  }
}

void ModeMachine::PullIfRuled(int64_t now_ns) {
  if (options_.conduct != ManagerConduct::kPull || pending_.contains(options_.system) ||
      target_ != options_.pull_from || TrueMode() != options_.pull_from) {
    pull_at_ns_ = 0;
    return;
  }
  if (pull_at_ns_ == 0) {
    pull_at_ns_ = now_ns + options_.pull_ns;
  }
  if (now_ns < pull_at_ns_) {
    return;
  }
  pending_[options_.system] = {options_.pull_to, now_ns + options_.transition_ns};
}

bool ModeMachine::Advance(int64_t now_ns) {
  bool changed = false;
  for (auto it = pending_.begin(); it != pending_.end();) {
    if (it->second.due_ns > now_ns) {
      ++it;
      continue;
    }
    Apply(it->first, it->second.mode);
    changed = true;
    it = pending_.erase(it);
  }
  PullIfRuled(now_ns);
  return changed;
}

void ModeMachine::Apply(absl::string_view part, absl::string_view mode) {
  if (part != options_.system) {
    SetNode(part, {PartState::kActive, std::string(mode)});
    return;
  }
  target_ = std::string(mode);
  for (const auto& [node, target] : smh_.systems.find(part)->second.modes.find(mode)->second) {
    SetNode(node, target);
  }
}

void ModeMachine::SetNode(absl::string_view node, const PartTarget& target) {
  NodeState& state = nodes_[node];
  if (state.stuck || !state.configured) {
    return;
  }
  not_inferred_.erase(std::string(node));
  state.active = target.state == PartState::kActive;
  if (!state.active && !state.mode.empty()) {
    return;
  }
  state.mode = target.mode.empty() ? std::string(kDefaultMode) : target.mode;
  state.parameters = smh_.nodes.find(node)->second.modes.find(state.mode)->second;
}

bool ModeMachine::Fits(absl::string_view mode) const {
  for (const auto& [node, target] :
       smh_.systems.find(options_.system)->second.modes.find(mode)->second) {
    const NodeState& state = nodes_.find(node)->second;
    const bool wants_active = target.state == PartState::kActive;
    if (state.active != wants_active || (wants_active && state.mode != target.mode)) {
      return false;
    }
  }
  return true;
}

std::string ModeMachine::TrueMode() const {
  const auto& modes = smh_.systems.find(options_.system)->second.modes;
  if (modes.contains(target_) && Fits(target_)) {
    return target_;
  }
  for (const auto& [mode, unused] : modes) {
    if (Fits(mode)) {
      return mode;
    }
  }
  return "";
}

std::string ModeMachine::Mode(absl::string_view part) const {
  if (part == options_.system) {
    if (!not_inferred_.empty()) {
      return "unknown";
    }
    return options_.conduct == ManagerConduct::kDeceive && !claimed_.empty() ? claimed_
                                                                             : TrueMode();
  }
  const auto node = nodes_.find(part);
  if (node == nodes_.end()) {
    return "unknown";
  }
  return node->second.active ? node->second.mode : "";
}

Lifecycle ModeMachine::State(absl::string_view part) const {
  if (part == options_.system) {
    if (!not_inferred_.empty()) {
      return Lifecycle::kUnknown;
    }
    return pending_.contains(part) || Mode(part).empty() ? Lifecycle::kActivating
                                                         : Lifecycle::kActive;
  }
  const auto node = nodes_.find(part);
  if (node == nodes_.end()) {
    return Lifecycle::kUnknown;
  }
  if (!node->second.configured) {
    return Lifecycle::kUnconfigured;
  }
  return node->second.active ? Lifecycle::kActive : Lifecycle::kInactive;
}

std::vector<std::string> ModeMachine::AvailableModes(absl::string_view part) const {
  std::vector<std::string> modes;
  if (const auto system = smh_.systems.find(part);
      system != smh_.systems.end() && part == options_.system) {
    for (const auto& [name, unused] : system->second.modes) {
      if (!removed_.contains(name)) {
        modes.push_back(name);
      }
    }
  } else if (const auto node = smh_.nodes.find(part);
             node != smh_.nodes.end() && nodes_.contains(part)) {
    for (const auto& [name, unused] : node->second.modes) {
      modes.push_back(name);
    }
  }
  return modes;
}

}  // namespace rips::robot_sim
