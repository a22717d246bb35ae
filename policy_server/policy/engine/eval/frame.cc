#include "policy_server/policy/engine/eval/frame.h"

#include <algorithm>
#include <utility>

namespace rips::engine {

Frame::Frame(const RobotState& state, const std::shared_ptr<const CompiledPolicy>& program,
             const Event& event, int64_t time_ns, Instant now, TopicCache* cache,
             const ParkedChain* parked)
    : state_(state),
      program_(program),
      event_(event),
      parked_(parked),
      in_force_(state.program() == program),
      run_(state.graph.get()) {
  run_.program = program_.get();
  run_.compiled = &program_->compiled();
  run_.state = &state_;
  run_.scene.dialect = program_->rules().dialect;
  if (in_force_) {
    run_.variables.Use(state_.internal().values);
  } else {
    run_.variables = FindVariables();
  }
  run_.time_ns = time_ns;
  run_.uptime_ns =
      static_cast<int64_t>(static_cast<uint64_t>(now.boottime_ns) -
                           static_cast<uint64_t>(state_.internal().started.boottime_ns));
  run_.string_max = state_.internal().limits.string_max;
  run_.message = std::get_if<MessageEvent>(&event.what);
  run_.external = std::get_if<ExternalEvent>(&event.what);
  const uint64_t revision = state_.graph.revision();
  if (cache != nullptr) run_.graph_answers = &cache->GraphAnswers(revision);
  if (run_.message == nullptr) return;

  EvalContext& scene = run_.scene;
  scene.topic = run_.message->topic;
  if (cache != nullptr) {
    run_.topic = &cache->Look(*program_, scene.graph, revision, *run_.message);
    scene.facts = run_.topic->facts;
    scene.types = run_.topic->types;
    return;
  }
  scene.facts = scene.graph.FindTopic(scene.topic);
  if (scene.facts != nullptr) types_.assign(scene.facts->types.begin(), scene.facts->types.end());
  const absl::string_view type = run_.message->type;
  if (!type.empty() && std::find(types_.begin(), types_.end(), type) == types_.end()) {
    types_.push_back(type);
  }
  scene.types = types_;
}

Variables Frame::FindVariables() const {
  const std::vector<lang::Value>& values = state_.internal().values;
  const std::vector<lang::Variable>& declared = program_->rules().variables;
  const CompiledPolicy& current = *state_.program();
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

Evaluation& Frame::Enter(const lang::TypedRule& rule, levels::LevelIndex level) {
  if (level != entered_) {
    const levels::LevelTable& own = program_->rules().levels;
    run_.level_name = state_.level.table().at(level).name;
    // A level that older rules do not know is above all that they know.
    run_.level = in_force_ ? level : own.Find(run_.level_name).value_or(own.size());
    entered_ = level;
  }
  run_.rule_name = rule.name;
  run_.fault = absl::string_view();
  run_.cut = false;
  run_.graph_open = false;
  run_.texts.clear();
  return run_;
}

}  // namespace rips::engine
