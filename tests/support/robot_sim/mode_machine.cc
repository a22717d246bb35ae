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
  const bool activate = transition == kTransitionActivate && !it->second.active;
  const bool deactivate = transition == kTransitionDeactivate && it->second.active;
  if (activate || deactivate) {
    it->second.active = activate;
  }
  return activate || deactivate;
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
  if (Fits(target_)) {
    return target_;
  }
  for (const std::string& mode : AvailableModes(options_.system)) {
    if (Fits(mode)) {
      return mode;
    }
  }
  return "";
}

std::string ModeMachine::Mode(absl::string_view part) const {
  if (part == options_.system) {
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
    return pending_.contains(part) || Mode(part).empty() ? Lifecycle::kActivating
                                                         : Lifecycle::kActive;
  }
  const auto node = nodes_.find(part);
  if (node == nodes_.end()) {
    return Lifecycle::kUnknown;
  }
  return node->second.active ? Lifecycle::kActive : Lifecycle::kInactive;
}

std::vector<std::string> ModeMachine::AvailableModes(absl::string_view part) const {
  std::vector<std::string> modes;
  if (const auto system = smh_.systems.find(part);
      system != smh_.systems.end() && part == options_.system) {
    for (const auto& [name, unused] : system->second.modes) {
      modes.push_back(name);
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
