#include "policy_server/policy/engine/evaluator.h"

#include <algorithm>
#include <utility>

#include "policy_server/policy/engine/chains/chains.h"
#include "policy_server/policy/engine/eval/frame.h"

namespace rips::engine {
namespace {

// Takes out, in order, the parked chains for which `answer` has one.
template <typename Verdict>
std::vector<Answered> TakeAnswered(RobotState& state, const Verdict& answer) {
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

}  // namespace

std::vector<uint32_t> NeededInspections(const Event& event, Instant now, RobotState& state) {
  std::vector<uint32_t> needed;
  if (state.halted() || !std::holds_alternative<MessageEvent>(event.what)) return needed;
  const std::shared_ptr<const CompiledPolicy>& program = state.program();
  if (program->rules().inspections.empty()) return needed;
  Frame frame(state, program, event, state.internal().time_ns, now, &state.internal().topics);
  const CompiledPolicy::Compiled& compiled = program->compiled();
  for (const uint32_t index : frame.topic()->verdict->inspecting) {
    Evaluation& run = frame.Enter(program->rules().rules[index], state.level.level());
    run.foreseeing = true;
    run.asked = &needed;
    Slot out;
    const EvalStatus answer = Eval(*compiled.conditions[index], run, out);
    if (answer == EvalStatus::kValue && !out.truth) continue;
    const std::vector<uint32_t>& in_arguments = compiled.needs[index].argument_inspections;
    needed.insert(needed.end(), in_arguments.begin(), in_arguments.end());
  }
  std::sort(needed.begin(), needed.end());
  needed.erase(std::unique(needed.begin(), needed.end()), needed.end());
  return needed;
}

Outcome Evaluate(const Event& event, Instant now, RobotState& state) {
  Outcome outcome;
  if (state.halted()) return outcome;
  Runner(now, state, outcome).Run(event);
  return outcome;
}

Outcome OnProgramResult(uint64_t run_id, bool ok, Instant now, RobotState& state) {
  Outcome outcome;
  if (state.internal().runs.erase(run_id) == 0 || state.halted()) return outcome;
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

}  // namespace rips::engine
