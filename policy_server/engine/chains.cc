#include "policy_server/engine/chains.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/engine/compiled.h"

namespace rips::engine {
namespace {

using lang::ActionKind;
using lang::Connector;

constexpr int64_t kAlertEveryNs = kNanosPerSecond;

bool GoesOn(Connector next, bool ok) {
  switch (next) {
    case Connector::kEnd:
      return false;
    case Connector::kIfSucceeded:
      return ok;
    case Connector::kIfFailed:
      return !ok;
    case Connector::kAlways:
      return true;
  }
  return false;
}

bool IsLast(const lang::TypedChain& chain, size_t index) {
  return index + 1 >= chain.size() || chain[index].next == Connector::kEnd;
}

Severity ParseSeverity(absl::string_view text) {
  for (const Severity severity :
       {Severity::kInfo, Severity::kLow, Severity::kMedium, Severity::kHigh, Severity::kCritical}) {
    if (text == ToString(severity)) return severity;
  }
  return Severity::kMedium;
}

// `later` is not before `earlier`; the difference may be the whole range of a clock.
bool Apart(int64_t earlier, int64_t later, int64_t ns) {
  return static_cast<uint64_t>(later) - static_cast<uint64_t>(earlier) >= static_cast<uint64_t>(ns);
}

}  // namespace

std::optional<bool> AnswerOf(levels::LevelIndex wants, bool lowering, const RobotState& state) {
  const levels::LevelIndex level = state.level.level();
  // Overtaken by another decision: this one will not be verified any more.
  if (lowering ? level != wants : level < wants) return false;
  switch (state.actuation) {
    case Actuation::kNoLease:
    case Actuation::kFailed:
      return false;
    case Actuation::kVerified:
      return true;
    case Actuation::kPending:
      return std::nullopt;
  }
  return false;
}

void Runner::Run(const Event& event) {
  in_.time_ns = std::max(in_.time_ns, event.time_unix_ns);
  const std::shared_ptr<const Program> program = state_.program();
  Frame frame(state_, program, event, in_.time_ns, nullptr);
  const std::vector<uint32_t>* rules = &program->compiled().external_rules;
  if (std::holds_alternative<MessageEvent>(event.what)) {
    const TopicVerdict& verdict = in_.verdicts.For(*program, frame.scene());
    frame.set_verdict(&verdict);
    rules = &verdict.rules;
  } else if (std::holds_alternative<GraphEvent>(event.what)) {
    rules = &program->compiled().graph_rules;
  }
  for (const uint32_t index : *rules) RunRule(frame, index);
}

void Runner::Resume(std::vector<Answered> answered) {
  for (const Answered& answer : answered) {
    const ParkedChain& parked = *answer.chain;
    Frame frame(state_, parked.program, parked.event, parked.time_ns, &parked);
    const lang::TypedRule& rule = parked.program->rules().rules[parked.rule];
    Current current{.frame = frame, .rule_index = parked.rule, .rule = rule};
    if (GoesOn(rule.chains[parked.chain][parked.action].next, answer.ok)) {
      RunChain(current, parked.chain, parked.action + 1);
    }
  }
}

void Runner::RunRule(Frame& frame, uint32_t index) {
  Current current{
      .frame = frame, .rule_index = index, .rule = frame.program().rules().rules[index]};
  const Context context = frame.For(current.rule, state_.level.level(), now_);
  Expression expression(context);
  const std::optional<Scalar> value = expression.Eval(current.rule.condition);
  NoteCut(current, expression);
  if (!value.has_value()) {
    ReportFault(current, expression.fault(), "it did not fire");
    return;
  }
  const bool* truth = std::get_if<bool>(&*value);
  if (truth == nullptr || !*truth) return;

  ++outcome_.fired;
  for (uint32_t chain = 0; chain < current.rule.chains.size() && !current.faulted; ++chain) {
    RunChain(current, chain, 0);
  }
}

void Runner::RunChain(Current& current, uint32_t chain, size_t action) {
  const lang::TypedChain& actions = current.rule.chains[chain];
  for (; action < actions.size(); ++action) {
    const Step step = Act(current, chain, action);
    if (step == Step::kParked) return;
    if (!GoesOn(actions[action].next, step == Step::kSucceeded)) return;
  }
}

Runner::Step Runner::Act(Current& current, uint32_t chain, size_t index) {
  const lang::TypedAction& action = current.rule.chains[chain][index];
  if (action.args.empty()) {
    ReportFault(current, "an action without arguments", "the action failed");
    return Step::kFailed;
  }
  switch (action.kind) {
    case ActionKind::kAlert:
      return Alert(current, action);
    case ActionKind::kSet:
      return Set(current, action);
    case ActionKind::kExec:
      return Exec(current, chain, index);
    case ActionKind::kTrigger:
      return Trigger(current, chain, index);
  }
  return Step::kFailed;
}

Runner::Step Runner::Alert(Current& current, const lang::TypedAction& action) {
  std::optional<std::string> text = TextArg(current, action.args[0]);
  if (!text.has_value()) return Step::kFailed;
  Severity severity = Severity::kMedium;
  if (action.args.size() > 1) {
    const std::optional<std::string> name = TextArg(current, action.args[1]);
    if (!name.has_value()) return Step::kFailed;
    severity = ParseSeverity(*name);
  }
  Raise(current, severity, *std::move(text));
  return Step::kSucceeded;
}

Runner::Step Runner::Set(Current& current, const lang::TypedAction& action) {
  std::optional<lang::Value> value = Arg(current, action.args[0]);
  if (!value.has_value()) return Step::kFailed;
  const Program& program = current.frame.program();
  const lang::Variable& variable = program.rules().variables.at(action.variable);
  uint32_t index = action.variable;
  if (!current.frame.in_force()) {
    const Program& in_force = *state_.program();
    const auto found = in_force.compiled().variable_of.find(variable.name);
    if (found == in_force.compiled().variable_of.end() ||
        in_force.rules().variables[found->second].type != variable.type) {
      return Step::kSucceeded;
    }
    index = found->second;
  }
  if (in_.values[index] != *value) {
    in_.values[index] = *std::move(value);
    outcome_.variables_changed = true;
  }
  return Step::kSucceeded;
}

Runner::Step Runner::Exec(Current& current, uint32_t chain, size_t index) {
  const lang::TypedChain& actions = current.rule.chains[chain];
  std::vector<std::string> args;
  for (const lang::TypedExpr& arg : actions[index].args) {
    std::optional<std::string> text = TextArg(current, arg);
    if (!text.has_value()) return Step::kFailed;
    args.push_back(*std::move(text));
  }
  std::string program = std::move(args.front());
  args.erase(args.begin());
  if (current.frame.event().lateness == levels::Lateness::kLate) {
    outcome_.refused_programs.push_back({current.rule.name, std::move(program), "late"});
    return Step::kFailed;
  }

  const bool last = IsLast(actions, index);
  auto run = std::find_if(in_.runs.begin(), in_.runs.end(), [&](const auto& entry) {
    return entry.second.program == program && entry.second.args == args;
  });
  const bool joins = run != in_.runs.end();
  if ((!joins && in_.runs.size() >= in_.limits.parked_max) || (!last && Full())) {
    ReportFull(current);
    outcome_.refused_programs.push_back(
        {current.rule.name, std::move(program), "too many in flight"});
    return Step::kFailed;
  }
  if (!joins) {
    const uint64_t id = ++in_.last_run_id;
    outcome_.effects.push_back(RunProgramEffect{
        .run_id = id, .rule = current.rule.name, .program = program, .args = args});
    run = in_.runs
              .emplace(id, ProgramRun{std::move(program), std::move(args),
                                      now_.boottime_ns + in_.limits.program_deadline_ns})
              .first;
  }
  if (last) return Step::kSucceeded;
  std::unique_ptr<ParkedChain> parked = MakeParked(current, chain, index);
  parked->run_id = run->first;
  in_.parked.push_back(std::move(parked));
  return Step::kParked;
}

Runner::Step Runner::Trigger(Current& current, uint32_t chain, size_t index) {
  const lang::TypedChain& actions = current.rule.chains[chain];
  const std::optional<levels::LevelIndex> to = LevelArg(current, actions[index].args[0]);
  if (!to.has_value()) return Step::kFailed;
  levels::Transition transition =
      state_.level.Request(*to, {.kind = levels::Cause::Kind::kRule, .name = current.rule.name},
                           now_, state_.evidence, current.frame.event().lateness);
  const bool lowering = transition.lowers();
  if (transition.refused()) {
    Refuse(std::move(transition));
    return Step::kFailed;
  }
  if (transition.decided()) {
    if (state_.actuation != Actuation::kNoLease) state_.actuation = Actuation::kPending;
    outcome_.effects.push_back(TransitionEffect{.transition = std::move(transition)});
  }

  const std::optional<bool> answer = AnswerOf(*to, lowering, state_);
  if (answer.has_value()) return *answer ? Step::kSucceeded : Step::kFailed;
  if (IsLast(actions, index)) return Step::kSucceeded;
  if (Full()) {
    // The decision stands; only the waiting for it is refused.
    ReportFull(current);
    return Step::kFailed;
  }
  std::unique_ptr<ParkedChain> parked = MakeParked(current, chain, index);
  parked->wants = *to;
  parked->lowering = lowering;
  in_.parked.push_back(std::move(parked));
  return Step::kParked;
}

std::optional<lang::Value> Runner::Arg(Current& current, const lang::TypedExpr& arg) {
  const Context context = current.frame.For(current.rule, state_.level.level(), now_);
  Expression expression(context);
  const std::optional<Scalar> value = expression.Eval(arg);
  NoteCut(current, expression);
  if (value.has_value()) return Own(*value);
  ReportFault(current, expression.fault(), "the action failed");
  return std::nullopt;
}

std::optional<std::string> Runner::TextArg(Current& current, const lang::TypedExpr& arg) {
  std::optional<lang::Value> value = Arg(current, arg);
  if (!value.has_value()) return std::nullopt;
  if (auto* text = std::get_if<std::string>(&*value)) return std::move(*text);
  ReportFault(current, "an argument that is no string", "the action failed");
  return std::nullopt;
}

std::optional<levels::LevelIndex> Runner::LevelArg(Current& current, const lang::TypedExpr& arg) {
  const std::optional<lang::Value> value = Arg(current, arg);
  if (!value.has_value()) return std::nullopt;
  const int64_t* position = std::get_if<int64_t>(&*value);
  const levels::LevelTable& own = current.frame.program().rules().levels;
  if (position != nullptr && *position >= 0 && *position < own.size()) {
    // Older rules mean a level by its name.
    const auto level = state_.level.table().Find(own.name(static_cast<int>(*position)));
    if (level.has_value()) return level;
  }
  ReportFault(current, "`trigger` of a level that does not exist", "the action failed");
  return std::nullopt;
}

void Runner::ReportFault(Current& current, absl::string_view what, absl::string_view consequence) {
  if (!current.faulted) ++outcome_.faults;
  current.faulted = true;
  const auto last = in_.fault_alerted_ns.find(current.rule.name);
  if (last != in_.fault_alerted_ns.end() && !Apart(last->second, in_.time_ns, kAlertEveryNs)) {
    return;
  }
  in_.fault_alerted_ns[current.rule.name] = in_.time_ns;
  Raise(current, Severity::kHigh,
        absl::StrCat("fault in rule `", current.rule.name, "`: ", what, "; ", consequence));
}

void Runner::ReportFull(const Current& current) {
  if (in_.full_alerted_ns.has_value() &&
      !Apart(*in_.full_alerted_ns, now_.boottime_ns, kAlertEveryNs)) {
    return;
  }
  in_.full_alerted_ns = now_.boottime_ns;
  Raise(current, Severity::kHigh,
        absl::StrCat("rule `", current.rule.name, "`: ", in_.limits.parked_max,
                     " chains or programs of this robot are under way, which is the limit; the "
                     "action failed"));
}

void Runner::NoteCut(const Current& current, const Expression& expression) {
  if (expression.cut() && in_.cut_rules.insert(current.rule.name).second) {
    outcome_.cut_strings.push_back(current.rule.name);
  }
}

void Runner::Refuse(levels::Transition transition) {
  RefusalRecord& record = in_.refusals[{transition.cause.name, transition.to}];
  const bool again = record.count > 0 && record.from == transition.from &&
                     record.reason == transition.refusal && record.based_on == transition.based_on;
  record = {.from = transition.from,
            .reason = transition.refusal,
            .based_on = transition.based_on,
            .count = again ? record.count + 1 : 1};
  outcome_.effects.push_back(
      TransitionEffect{.transition = std::move(transition), .count = record.count});
}

void Runner::Raise(const Current& current, Severity severity, std::string text) {
  outcome_.effects.push_back(AlertEffect{.rule = current.rule.name,
                                         .severity = severity,
                                         .text = std::move(text),
                                         .level = state_.level.level(),
                                         .mark = state_.level.mark()});
}

std::unique_ptr<ParkedChain> Runner::MakeParked(const Current& current, uint32_t chain,
                                                size_t index) {
  const Frame& frame = current.frame;
  auto parked = std::make_unique<ParkedChain>();
  parked->program = frame.shared_program();
  parked->rule = current.rule_index;
  parked->chain = chain;
  parked->action = index;
  parked->event = frame.event();
  if (auto* message = std::get_if<MessageEvent>(&parked->event.what)) {
    parked->topic = std::string(message->topic);
    parked->type = std::string(message->type);
    parked->sender = std::string(message->sender);
    message->topic = parked->topic;
    message->type = parked->type;
    message->sender = parked->sender;
  }
  parked->time_ns = frame.time_ns();
  parked->deadline_ns = now_.boottime_ns + in_.limits.chain_deadline_ns;
  if (frame.parked() != nullptr) parked->left_behind = frame.parked()->left_behind;
  return parked;
}

}  // namespace rips::engine
