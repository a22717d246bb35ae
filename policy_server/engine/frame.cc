#include "policy_server/engine/frame.h"

#include <algorithm>
#include <utility>

namespace rips::engine {

Frame::Frame(const RobotState& state, std::shared_ptr<const Program> program, const Event& event,
             int64_t time_ns, const ParkedChain* parked)
    : state_(state),
      program_(std::move(program)),
      event_(event),
      time_ns_(time_ns),
      parked_(parked),
      in_force_(state.program() == program_),
      variables_(FindVariables()),
      scene_({.graph = state.graph, .dialect = program_->rules().dialect}) {
  if (const auto* message = std::get_if<MessageEvent>(&event.what)) Look(*message);
}

Variables Frame::FindVariables() const {
  const std::vector<lang::Value>& values = state_.internal().values;
  if (in_force_) return Variables(&values);
  const std::vector<lang::Variable>& declared = program_->rules().variables;
  const Program& current = *state_.program();
  std::vector<const lang::Value*> places(declared.size(), nullptr);
  for (size_t i = 0; i < declared.size(); ++i) {
    const auto now_at = current.compiled().variable_of.find(declared[i].name);
    if (now_at != current.compiled().variable_of.end() &&
        current.rules().variables[now_at->second].type == declared[i].type) {
      places[i] = &values[now_at->second];
    } else if (parked_ != nullptr && parked_->left_behind != nullptr) {
      places[i] = &(*parked_->left_behind)[i];
    }
  }
  return Variables(std::move(places));
}

void Frame::Look(const MessageEvent& message) {
  scene_.topic = message.topic;
  scene_.facts = state_.graph.FindTopic(message.topic);
  if (scene_.facts != nullptr) {
    types_.assign(scene_.facts->types.begin(), scene_.facts->types.end());
  }
  if (!message.type.empty() &&
      std::find(types_.begin(), types_.end(), message.type) == types_.end()) {
    types_.push_back(message.type);
  }
  scene_.types = types_;
}

Context Frame::For(const lang::TypedRule& rule, levels::LevelIndex level, Instant now) const {
  const levels::LevelTable& table = state_.level.table();
  const absl::string_view name = table.at(level).name;
  const levels::LevelTable& own = program_->rules().levels;
  const Instant& started = state_.internal().started;
  return {.program = *program_,
          .rule = rule,
          .scene = scene_,
          .verdict = verdict_,
          .variables = variables_,
          // A level that older rules do not know is above all that they know.
          .level = in_force_ ? level : own.Find(name).value_or(own.size()),
          .level_name = name,
          .time_ns = time_ns_,
          .uptime_ns = static_cast<int64_t>(static_cast<uint64_t>(now.boottime_ns) -
                                            static_cast<uint64_t>(started.boottime_ns)),
          .string_max = state_.internal().limits.string_max};
}

}  // namespace rips::engine
