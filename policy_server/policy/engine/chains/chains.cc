#include "policy_server/policy/engine/chains/chains.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/engine/state/compiled.h"
#include "policy_server/policy/engine/state/message_counts.h"
#include "policy_server/policy/engine/trace/tracer.h"
#include "policy_server/policy/lang/value_text.h"

namespace rips::engine {
namespace {

using lang::ActionKind;
using lang::Connector;

constexpr int64_t kAlertEveryNs = kNanosPerSecond;

// A rule asks for a level.
void NoteRequest(RobotState::Internal& state, const std::string& rule, levels::LevelIndex to) {
  LevelRequests& requests = state.level_requests[to];
  ++requests.count;
  requests.rule = rule;
}

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

// Not more often in this second of `Time`; counts it.
bool MayTrace(const std::string& rule, RobotState::Internal& in) {
  TraceCount& count = in.traces[rule];
  const int64_t second = in.time_ns / kNanosPerSecond;
  if (count.second != second) count = {.second = second};
  if (count.traces >= TraceCount::kMax) return false;
  ++count.traces;
  return true;
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
  // Nobody swaps it while rules run.
  const std::shared_ptr<const CompiledPolicy>& program = state_.program();
  if (const auto* external = std::get_if<ExternalEvent>(&event.what)) {
    if (const auto* loss = std::get_if<model::Loss>(external))
      CountLoss(*loss, in_.time_ns, state_);
  }
  Frame frame(state_, program, event, in_.time_ns, now_, &in_.topics);
  const std::vector<uint32_t>* rules = &program->compiled().external_rules;
  if (const auto* message = std::get_if<MessageEvent>(&event.what)) {
    CountMessage(*message, *frame.topic()->verdict, frame.time_ns(), in_);
    rules = &frame.topic()->verdict->rules;
  } else if (std::holds_alternative<GraphEvent>(event.what)) {
    rules = &program->compiled().graph_rules;
  }
  for (const uint32_t index : *rules) {
    RunRule(frame, index);
    if (state_.halted()) break;
  }
  outcome_.steps += frame.steps();
}

void Runner::Resume(std::vector<Answered> answered) {
  for (const Answered& answer : answered) {
    if (state_.halted()) return;
    const ParkedChain& parked = *answer.chain;
    const bool in_force = parked.program == state_.program();
    Frame frame(state_, parked.program, parked.event, parked.time_ns, now_,
                in_force ? &in_.topics : nullptr, &parked);
    const lang::TypedRule& rule = parked.program->rules().rules[parked.rule];
    Current current{.frame = frame, .rule_index = parked.rule, .rule = rule, .trace = parked.trace};
    if (GoesOn(rule.chains[parked.chain][parked.action].next, answer.ok)) {
      RunChain(current, parked.chain, parked.action + 1);
    }
    outcome_.steps += frame.steps();
  }
}

void Runner::RunRule(Frame& frame, uint32_t index) {
  Current current{
      .frame = frame, .rule_index = index, .rule = frame.program().rules().rules[index]};
  if (!Fires(current)) return;
  ++outcome_.fired;
  if (frame.program().compiled().needs[index].tells && MayTrace(current.rule.name, in_)) {
    current.trace = std::make_shared<const Trace>(TraceRule(frame, index, state_.level.level()));
  }
  for (uint32_t chain = 0;
       chain < current.rule.chains.size() && !current.faulted && !state_.halted(); ++chain) {
    RunChain(current, chain, 0);
  }
  using RuleResult = RuleObserver::RuleResult;
  if (current.graph_open && current.fault.empty()) {
    return Tell(current, RuleResult::kFiredUnscanned, kGraphTruncated);
  }
  Tell(current, current.unscanned ? RuleResult::kFiredUnscanned : RuleResult::kFired,
       current.fault);
}

bool Runner::Fires(Current& current) {
  Evaluation& run = current.frame.Enter(current.rule, state_.level.level());
  Slot value;
  const EvalStatus answer =
      Eval(*current.frame.program().compiled().conditions[current.rule_index], run, value);
  if (run.cut) NoteCut(current, run);
  if (answer == EvalStatus::kValue) {
    if (!value.truth) Tell(current, RuleObserver::RuleResult::kFalse);
    return value.truth;
  }
  if (answer == EvalStatus::kFault) {
    const std::string what(run.fault);
    ReportFault(current, what, "it did not fire");
    Tell(current, RuleObserver::RuleResult::kFaulted, what);
    return false;
  }
  if (answer == EvalStatus::kUndecidable) {
    ++outcome_.undecidable;
    Tell(current, RuleObserver::RuleResult::kUndecidable);
    return false;
  }
  ++outcome_.unscanned;
  const OnInspectionError then = current.frame.program().options().on_inspection_error;
  current.unscanned = then == OnInspectionError::kMatch;
  current.graph_open = run.graph_open;
  if (current.unscanned) return true;
  if (then == OnInspectionError::kAlert) {
    ReportFault(current, run.graph_open ? kGraphTruncated : "the message could not be inspected",
                "it did not fire");
  }
  Tell(current, RuleObserver::RuleResult::kUnscanned, run.graph_open ? kGraphTruncated : "");
  return false;
}

void Runner::Tell(const Current& current, RuleObserver::RuleResult came, absl::string_view what) {
  if (state_.observer != nullptr) state_.observer->OnRule(current.rule_index, came, what);
}

void Runner::RunChain(Current& current, uint32_t chain, size_t action) {
  const lang::TypedChain& actions = current.rule.chains[chain];
  for (; action < actions.size(); ++action) {
    const Step step = Act(current, chain, action);
    if (step == Step::kParked || state_.halted()) return;
    if (!GoesOn(actions[action].next, step == Step::kSucceeded)) return;
  }
}

Runner::Step Runner::Act(Current& current, uint32_t chain, size_t index) {
  const lang::TypedAction& action = current.rule.chains[chain][index];
  switch (action.kind) {
    case ActionKind::kAlert:
      return Alert(current, action);
    case ActionKind::kSet:
      return Set(current, action);
    case ActionKind::kExec:
      return Exec(current, chain, index);
    case ActionKind::kTrigger:
      return Trigger(current, chain, index);
    case ActionKind::kTrue:
    case ActionKind::kFalse:
      return Debug(current, action);
    case ActionKind::kCrash:
      return Crash(current, action);
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
  const CompiledPolicy& program = current.frame.program();
  const lang::Variable& variable = program.rules().variables.at(action.variable);
  uint32_t index = action.variable;
  if (!current.frame.in_force()) {
    const CompiledPolicy& in_force = *state_.program();
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
  if (state_.scripted != nullptr) {
    const bool ok = state_.scripted->RunProgram(program, args);
    Add(RunProgramEffect{.run_id = ++in_.last_run_id,
                         .rule = current.rule.name,
                         .program = std::move(program),
                         .args = std::move(args)});
    return ok ? Step::kSucceeded : Step::kFailed;
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
    Add(RunProgramEffect{
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
  NoteRequest(in_, current.rule.name, *to);
  // What was seen before a change says nothing about the level it led to.
  static const levels::Evidence kNoneYet = {
      .blind_because = {"the level has changed within this event"}};
  levels::Transition transition = state_.level.Request(
      *to, {.kind = levels::Cause::Kind::kRule, .name = current.rule.name}, now_,
      decided_ ? kNoneYet : state_.evidence, current.frame.event().lateness);
  const bool lowering = transition.lowers();
  if (transition.refused()) {
    Refuse(current, std::move(transition));
    return Step::kFailed;
  }
  if (transition.decided()) {
    decided_ = true;
    if (state_.actuation != Actuation::kNoLease) state_.actuation = Actuation::kPending;
    Add(TransitionEffect{.transition = std::move(transition), .trace = current.trace});
  }

  const std::optional<bool> answer =
      state_.scripted != nullptr ? state_.scripted->Reach(*to) : AnswerOf(*to, lowering, state_);
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

Runner::Step Runner::Debug(Current& current, const lang::TypedAction& action) {
  std::vector<std::string> values;
  for (const lang::TypedExpr& arg : action.args) {
    const std::optional<lang::Value> value = Arg(current, arg);
    if (!value.has_value()) return Step::kFailed;
    values.push_back(lang::ToText(*value));
  }
  Add(LogEffect{.rule = current.rule.name, .text = absl::StrJoin(values, " ")});
  return action.kind == ActionKind::kTrue ? Step::kSucceeded : Step::kFailed;
}

// Whatever the text comes to, the robot stops: a rule that wanted it crashed says so.
Runner::Step Runner::Crash(Current& current, const lang::TypedAction& action) {
  std::optional<std::string> text = TextArg(current, action.args[0]);
  NoteRequest(in_, current.rule.name, state_.level.table().size() - 1);
  levels::Transition transition =
      state_.level.Crash({.kind = levels::Cause::Kind::kCrash, .name = current.rule.name}, now_);
  if (transition.decided()) {
    decided_ = true;
    if (state_.actuation != Actuation::kNoLease) state_.actuation = Actuation::kPending;
    Add(TransitionEffect{.transition = std::move(transition), .trace = current.trace});
  }
  Raise(current, Severity::kCritical,
        absl::StrCat("crash: ", std::move(text).value_or("(its text could not be made)")));
  // Nothing of this robot's rules goes on.
  in_.parked.clear();
  in_.runs.clear();
  state_.Halt();
  outcome_.crashed = true;
  return Step::kFailed;
}

std::optional<lang::Value> Runner::Arg(Current& current, const lang::TypedExpr& arg) {
  const EvalNode& node = *current.frame.program().compiled().arguments.at(&arg);
  Evaluation& run = current.frame.Enter(current.rule, state_.level.level());
  Slot value;
  const EvalStatus answer = Eval(node, run, value);
  if (run.cut) NoteCut(current, run);
  if (answer == EvalStatus::kValue) return Own(value, node.type);
  const std::string what =
      answer == EvalStatus::kFault                         ? std::string(run.fault)
      : answer == EvalStatus::kUnscanned && run.graph_open ? std::string(kGraphTruncated)
      : answer == EvalStatus::kUnscanned ? "an argument needs an inspection that was not made"
                                         : "an argument needs what the recording does not hold";
  ReportFault(current, what, "the action failed");
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
  if (!current.faulted) {
    ++outcome_.faults;
    current.fault = std::string(what);
  }
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

void Runner::NoteCut(const Current& current, const Evaluation& run) {
  if (run.cut && in_.cut_rules.insert(current.rule.name).second) {
    outcome_.cut_strings.push_back(current.rule.name);
  }
}

void Runner::Refuse(const Current& current, levels::Transition transition) {
  RefusalRecord& record = in_.refusals[{transition.cause.name, transition.to}];
  const bool again = record.count > 0 && record.from == transition.from &&
                     record.reason == transition.refusal && record.based_on == transition.based_on;
  record = {.from = transition.from,
            .reason = transition.refusal,
            .based_on = transition.based_on,
            .count = again ? record.count + 1 : 1};
  Add(TransitionEffect{
      .transition = std::move(transition), .count = record.count, .trace = current.trace});
}

void Runner::Raise(const Current& current, Severity severity, std::string text) {
  Add(AlertEffect{.rule = current.rule.name,
                  .severity = severity,
                  .text = std::move(text),
                  .level = state_.level.level(),
                  .decision_id = state_.level.decision_id(),
                  .graph_truncated = current.graph_open,
                  .trace = current.trace});
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
    message->memo = nullptr;
    parked->inspections.assign(message->inspections.begin(), message->inspections.end());
    message->inspections = parked->inspections;
  }
  parked->time_ns = frame.time_ns();
  parked->trace = current.trace;
  parked->deadline_ns = now_.boottime_ns + in_.limits.chain_deadline_ns;
  if (frame.parked() != nullptr) parked->left_behind = frame.parked()->left_behind;
  return parked;
}

}  // namespace rips::engine
