#include "policy_server/policy/engine/foresight.h"

#include <algorithm>

#include "policy_server/policy/engine/eval/frame.h"
#include "policy_server/policy/engine/state/event.h"
#include "policy_server/policy/engine/trace/tracer.h"

namespace rips::engine {
namespace {

Event Tick() {
  Event tick;
  tick.what.emplace<ExternalEvent>(TickEvent{});
  return tick;
}

Frame FrameOf(const Event& event, Instant now, const RobotState& state) {
  return {state, state.program(), event, std::max(state.internal().time_ns, now.unix_ns),
          now,   nullptr};
}

// One of the rule's chains holds a trigger whose level `fits`.
template <typename Fits>
bool Triggers(const lang::TypedRule& rule, const Fits& fits) {
  return std::any_of(rule.chains.begin(), rule.chains.end(), [&](const lang::TypedChain& chain) {
    return std::any_of(chain.begin(), chain.end(), [&](const lang::TypedAction& action) {
      return action.kind == lang::ActionKind::kTrigger && !action.args.empty() &&
             fits(action.args[0]);
    });
  });
}

// The rule has been entered, and fires.
bool Holds(const CompiledPolicy& program, uint32_t index, Evaluation& run) {
  Slot out;
  const EvalStatus answer = Eval(*program.compiled().conditions[index], run, out);
  if (answer == EvalStatus::kValue) return out.truth;
  return answer == EvalStatus::kUnscanned &&
         program.options().on_inspection_error == OnInspectionError::kMatch;
}

// Adds the names of those of `rules` that would fire on `event` and raise.
void AddRaisers(const Event& event, const std::vector<uint32_t>& rules, levels::LevelIndex level,
                Instant now, const RobotState& state, std::vector<std::string>& names) {
  const CompiledPolicy& program = *state.program();
  Frame frame = FrameOf(event, now, state);
  for (const uint32_t index : rules) {
    const lang::TypedRule& rule = program.rules().rules[index];
    Evaluation& run = frame.Enter(rule, level);
    if (!Holds(program, index, run)) continue;
    if (Triggers(rule, [&](const lang::TypedExpr& to) {
          Slot out;
          return Eval(*program.compiled().arguments.at(&to), run, out) == EvalStatus::kValue &&
                 out.integer > level && out.integer < program.rules().levels.size();
        })) {
      names.push_back(rule.name);
    }
  }
}

void AddLowerers(const Event& event, const std::vector<uint32_t>& rules, Instant now,
                 const RobotState& state, std::vector<LoweringRule>& found) {
  const CompiledPolicy& program = *state.program();
  const levels::LevelIndex level = state.level.level();
  Frame frame = FrameOf(event, now, state);
  for (const uint32_t index : rules) {
    const lang::TypedRule& rule = program.rules().rules[index];
    if (found.size() == kLoweringRulesMax) return;
    Evaluation& run = frame.Enter(rule, level);
    if (!Triggers(rule, [&](const lang::TypedExpr& to) {
          Slot out;
          return Eval(*program.compiled().arguments.at(&to), run, out) == EvalStatus::kValue &&
                 out.integer == level - 1;
        })) {
      continue;
    }
    const bool holds = Holds(program, index, frame.Enter(rule, level));
    found.push_back({.name = rule.name, .holds = holds, .trace = TraceRule(frame, index, level)});
  }
}

}  // namespace

std::vector<std::string> WouldRaise(levels::LevelIndex level, Instant now,
                                    const RobotState& state) {
  std::vector<std::string> names;
  if (!state.level.table().contains(level)) return names;
  const CompiledPolicy::Compiled& compiled = state.program()->compiled();
  AddRaisers({.what = GraphEvent{}}, compiled.graph_rules, level, now, state, names);
  AddRaisers(Tick(), compiled.external_rules, level, now, state, names);
  return names;
}

std::vector<LoweringRule> LoweringRules(Instant now, const RobotState& state) {
  std::vector<LoweringRule> found;
  const levels::LevelIndex level = state.level.level();
  if (!state.level.table().at(level).soft) return found;
  const CompiledPolicy& program = *state.program();
  const CompiledPolicy::Compiled& compiled = program.compiled();
  AddLowerers({.what = GraphEvent{}}, compiled.graph_rules, now, state, found);
  AddLowerers(Tick(), compiled.external_rules, now, state, found);
  for (const uint32_t index : compiled.message_rules) {
    const lang::TypedRule& rule = program.rules().rules[index];
    if (found.size() == kLoweringRulesMax) break;
    if (!Triggers(rule, [&](const lang::TypedExpr& to) {
          return to.is_constant() && std::get<int64_t>(to.constant) == level - 1;
        })) {
      continue;
    }
    found.push_back({.name = rule.name, .holds = {}, .trace = DescribeRule(program, index)});
  }
  return found;
}

}  // namespace rips::engine
