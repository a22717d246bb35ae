#include "policy_server/engine/evaluator.h"

#include <algorithm>
#include <utility>

#include "policy_server/engine/chains.h"

namespace rips::engine {
namespace {

// Takes out, in order, the parked chains for which `answer` has one.
template <typename Answer>
std::vector<Answered> TakeAnswered(RobotState& state, const Answer& answer) {
  std::vector<Answered> answered;
  std::vector<std::unique_ptr<ParkedChain>> waiting;
  for (std::unique_ptr<ParkedChain>& chain : state.internal().parked) {
    const std::optional<bool> ok = answer(*chain);
    if (ok.has_value()) {
      answered.push_back({std::move(chain), *ok});
    } else {
      waiting.push_back(std::move(chain));
    }
  }
  state.internal().parked = std::move(waiting);
  return answered;
}

bool IsTrue(const std::optional<Scalar>& value) {
  const bool* truth = value.has_value() ? std::get_if<bool>(&*value) : nullptr;
  return truth != nullptr && *truth;
}

}  // namespace

Outcome Evaluate(const Event& event, Instant now, RobotState& state) {
  Outcome outcome;
  Runner(now, state, outcome).Run(event);
  return outcome;
}

Outcome OnProgramResult(uint64_t run_id, bool ok, Instant now, RobotState& state) {
  Outcome outcome;
  if (state.internal().runs.erase(run_id) == 0) return outcome;
  Runner(now, state, outcome).Resume(TakeAnswered(state, [&](const ParkedChain& chain) {
    return chain.run_id == run_id ? std::optional<bool>(ok) : std::nullopt;
  }));
  return outcome;
}

Outcome OnActuation(Instant now, RobotState& state) {
  Outcome outcome;
  // All are answered before one goes on, for what it does may change the answers.
  Runner(now, state, outcome).Resume(TakeAnswered(state, [&](const ParkedChain& chain) {
    return chain.run_id == 0 ? AnswerOf(chain.wants, chain.lowering, state) : std::nullopt;
  }));
  return outcome;
}

Outcome Expire(Instant now, RobotState& state) {
  Outcome outcome;
  auto& runs = state.internal().runs;
  for (auto run = runs.begin(); run != runs.end();) {
    run = now.boottime_ns >= run->second.deadline_ns ? runs.erase(run) : std::next(run);
  }
  Runner(now, state, outcome).Resume(TakeAnswered(state, [&](const ParkedChain& chain) {
    const bool over =
        now.boottime_ns >= chain.deadline_ns || (chain.run_id != 0 && !runs.contains(chain.run_id));
    return over ? std::optional<bool>(false) : std::nullopt;
  }));
  return outcome;
}

std::vector<std::string> WouldRaise(levels::LevelIndex level, Instant now,
                                    const RobotState& state) {
  std::vector<std::string> names;
  if (!state.level.table().contains(level)) return names;
  const Program& program = *state.program();
  const Event event{.what = GraphEvent{}};
  const Frame frame(state, state.program(), event, std::max(state.internal().time_ns, now.unix_ns),
                    nullptr);
  for (const uint32_t index : program.compiled().graph_rules) {
    const lang::TypedRule& rule = program.rules().rules[index];
    const Context context = frame.For(rule, level, now);
    Expression expression(context);
    if (!IsTrue(expression.Eval(rule.condition))) continue;
    const bool raises =
        std::any_of(rule.chains.begin(), rule.chains.end(), [&](const lang::TypedChain& chain) {
          return std::any_of(chain.begin(), chain.end(), [&](const lang::TypedAction& action) {
            if (action.kind != lang::ActionKind::kTrigger || action.args.empty()) return false;
            const std::optional<Scalar> to = expression.Eval(action.args[0]);
            const int64_t* position = to.has_value() ? std::get_if<int64_t>(&*to) : nullptr;
            return position != nullptr && *position > level &&
                   *position < program.rules().levels.size();
          });
        });
    if (raises) names.push_back(rule.name);
  }
  return names;
}

}  // namespace rips::engine
