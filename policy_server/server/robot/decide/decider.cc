#include "policy_server/server/robot/decide/decider.h"

#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/time.h"
#include "services/base/overloaded.h"

namespace rips::pipeline {
namespace {

void CountEffect(const engine::Effect& effect, RuleCounts& counts) {
  if (std::holds_alternative<engine::AlertEffect>(effect)) {
    ++counts.alerts;
  } else if (std::holds_alternative<engine::RunProgramEffect>(effect)) {
    ++counts.programs;
  } else if (const auto* change = std::get_if<engine::TransitionEffect>(&effect)) {
    const levels::Transition& transition = change->transition;
    if (transition.refused()) {
      ++counts.refusals;
    } else if (transition.decided() && transition.from != transition.to) {
      ++(transition.lowers() ? counts.lowerings : counts.raises);
    }
  }
}

void RecordEvent(const engine::Event& event, const Source& source, const levels::Evidence& evidence,
                 const engine::RobotState& state, Context& context) {
  if (!context.moment.recorded) return;
  const MessageSeen* message = source.message;
  context.Do(action::RecordEvent{
      {.event = event,
       .graph = state.graph.version().graph,
       .message = message,
       .batch = source.batch,
       .blind = !evidence.blind_because.empty(),
       .findings = state.findings,
       .payload_bytes_max = message == nullptr ? 0 : context.watch.PayloadBytes(message->topic),
       .muted = source.muted}});
}

// Behind a message's description, if several nodes have its sender's name: which of them wrote it,
// and which did not. Hosts are what participants say of themselves.
std::string NamesakesText(const engine::Event& event, const ros2::RosGraph& graph) {
  constexpr size_t kNamed = 4;  // others of that name, of as many as a peer may make
  const auto* message = std::get_if<engine::MessageEvent>(&event.what);
  if (message == nullptr || message->sender.empty()) return "";
  const auto place = [&graph](const ros2::Guid& guid) {
    const auto it = graph.participants().find(guid);
    const bool named = it != graph.participants().end() && !it->second.host.empty();
    return absl::StrCat("participant ", ToString(guid), named ? " on " : "",
                        named ? it->second.host : "");
  };
  const ros2::Guid writer = message->writer.Participant();
  const std::string name(message->sender);
  std::vector<std::string> others;
  bool more = false;
  for (auto it = graph.nodes().lower_bound({.full_name = name, .participant = {}});
       it != graph.nodes().end() && it->full_name == name && !more; ++it) {
    if (it->participant == writer) continue;
    more = others.size() == kNamed;
    others.push_back(more ? "and more" : place(it->participant));
  }
  if (others.empty()) return "";
  return absl::StrCat(" of ", place(writer),
                      "; other nodes of this name: ", absl::StrJoin(others, ", "));
}

// Behind a description: when it was, if that is not the time at which alerts of it are raised.
std::string LateText(const engine::Event& event) {
  if (event.lateness != levels::Lateness::kLate) return "";
  return absl::FormatTime(", taken at %Y-%m-%dT%H:%M:%E3SZ",
                          absl::FromUnixNanos(event.time_unix_ns), absl::UTCTimeZone());
}

// To those who compare.
void RecordOutcome(const engine::Outcome& outcome, const engine::RobotState& state,
                   Context& context) {
  if (!context.watch.also() || !context.moment.recorded) return;
  RuleOutcome recorded{.counts = {.faults = outcome.faults}, .level = {}};
  for (const engine::Effect& effect : outcome.effects) CountEffect(effect, recorded.counts);
  if (recorded.counts == RuleCounts{}) return;
  recorded.level = state.level.table().name(state.level.level());
  context.Do(action::RecordOutcome{std::move(recorded)});
}

}  // namespace

std::string CauseText(const levels::Cause& cause) {
  switch (cause.kind) {
    case levels::Cause::Kind::kRule:
      return absl::StrCat("rule ", cause.name);
    case levels::Cause::Kind::kOperator:
      return absl::StrCat("operator ", cause.name);
    case levels::Cause::Kind::kCrash:
      return absl::StrCat("crash in rule ", cause.name);
    case levels::Cause::Kind::kAdopted:
      return "adopted";
  }
  return "";
}

bool Decider::Run(const engine::Event& event, const Source& source) {
  levels::Evidence evidence = evidence_.Assess(context_.now());
  RecordEvent(event, source, evidence, state_, context_);
  if (source.muted) return false;
  state_.evidence = std::move(evidence);
  const engine::Outcome outcome = engine::Evaluate(event, context_.now(), state_);
  if (!outcome.effects.empty() || outcome.faults > 0 || !outcome.refused_programs.empty() ||
      !outcome.cut_strings.empty()) {
    const std::string late = LateText(event);
    const std::string text = absl::StrCat(
        engine::Describe(event), NamesakesText(event, state_.graph.get()), late, source.remark);
    Perform(outcome, text, late.empty() ? "" : text);
  } else if (outcome.variables_changed) {
    outbox_.Touch(&DurableOutbox::Unsaved::variables);
  }
  return outcome.variables_changed;
}

void Decider::RunEvents() {
  while (!context_.events.empty()) {
    engine::ExternalEvent event = std::move(context_.events.front());
    context_.events.pop_front();
    Run({.what = std::move(event), .time_unix_ns = context_.now().unix_ns});
  }
}

void Decider::OnActuation(engine::Actuation actuation) {
  if (actuation == state_.actuation) return;
  state_.actuation = actuation;
  Perform(engine::OnActuation(context_.now(), state_), "level report");
}

void Decider::OnProgramResult(const ProgramResult& result) {
  Perform(engine::OnProgramResult(result.run_id, result.ok, context_.now(), state_),
          "program result");
}

void Decider::Expire() { Perform(engine::Expire(context_.now(), state_), "deadline"); }

void Decider::Perform(const engine::Outcome& outcome, const std::string& event,
                      const std::string& late) {
  RecordOutcome(outcome, state_, context_);
  if (outcome.variables_changed) outbox_.Touch(&DurableOutbox::Unsaved::variables);
  for (const auto& refused : outcome.refused_programs) {
    alerts_.Raise(engine::Severity::kMedium,
                  absl::StrCat("program `", refused.program, "` of rule ", refused.rule,
                               " was not run: ", refused.reason));
  }
  for (const std::string& rule : outcome.cut_strings) {
    alerts_.Raise(engine::Severity::kLow,
                  absl::StrCat("rule ", rule, " made a string that is too long; it was cut"));
  }
  for (const engine::Effect& effect : outcome.effects) {
    std::visit(
        Overloaded{
            [&](const engine::AlertEffect& alert) { alerts_.RaiseOfRule(alert, event); },
            [&](const engine::TransitionEffect& transition) { OnTransition(transition, late); },
            [&](const engine::RunProgramEffect& run) {
              std::string refused = actuators_.Run(run);
              if (refused.empty()) return;
              alerts_.Raise(engine::Severity::kHigh,
                            absl::StrCat("program `", run.program, "` of rule ", run.rule,
                                         " was not run: ", refused));
              OnProgramResult({.run_id = run.run_id, .detail = std::move(refused)});
            },
            [&](const engine::LogEffect& log) {
              context_.Do(action::LogRule{.rule = log.rule, .text = log.text});
            }},
        effect);
  }
}

void Decider::OnTransition(const engine::TransitionEffect& effect, const std::string& late) {
  const levels::Transition& transition = effect.transition;
  if (transition.refused()) return OnRefusal(effect);
  if (!transition.decided()) return;
  const levels::LevelTable& table = state_.level.table();
  outbox_.AddDecision({.id = context_.ids.Next(),
                       .decision_id = transition.decision_id,
                       .based_on = transition.based_on,
                       .from = table.name(transition.from),
                       .to = table.name(transition.to),
                       .cause = CauseText(transition.cause),
                       .reason = transition.cause.reason.empty() ? late : transition.cause.reason,
                       .time_unix_ns = transition.at.unix_ns,
                       .trace = CopyOf(effect.trace)});
  using Kind = levels::Cause::Kind;
  const Kind kind = transition.cause.kind;
  if (context_.moment.recorded && kind != Kind::kRule && kind != Kind::kCrash) {
    context_.Do(action::RecordLevel{{.to = table.name(transition.to),
                                     .cause = CauseText(transition.cause),
                                     .time_unix_ns = transition.at.unix_ns}});
  }
  evidence_.Restart(context_.now());
  // A raise from a lowering that is not durable yet lowers the robot, too, unless it leads at least
  // to where the robot was ordered.
  const bool after_lowering =
      !outbox_.held_back().none() && transition.to < actuators_.reconciler().level();
  if (transition.lowers() || after_lowering) {
    outbox_.AddLowering(transition);
  } else {
    actuators_.Order(transition, CauseText(transition.cause));
  }
}

// One record per kind of refusal; its count moves on.
void Decider::OnRefusal(const engine::TransitionEffect& effect) {
  const levels::Transition& transition = effect.transition;
  const levels::LevelTable& table = state_.level.table();
  if (transition.refusal == levels::Refusal::kBudget && !std::exchange(budget_spent_, true)) {
    constexpr levels::SoftBudget kBudget;
    alerts_.Raise(
        engine::Severity::kHigh,
        absl::StrCat("rules have lowered the level ", kBudget.lowerings_max, " times in ",
                     kBudget.window_ns / (60 * kNanosPerSecond),
                     " minutes: they lower it no more until an operator says `ripsctl rules ",
                     "resume ", context_.config.id, " --reason TEXT`"));
  }
  const std::string key = absl::StrCat(CauseText(transition.cause), "\n", transition.from, "\n",
                                       transition.to, "\n", levels::ToString(transition.refusal));
  auto [it, fresh] = refusal_ids_.try_emplace(key);
  if (fresh || effect.count == 1) it->second = context_.ids.Next();
  const bool round = (effect.count & (effect.count - 1)) == 0;
  if (!round) return;  // counts are written at 1, 2, 4, 8, ...
  std::string reason(levels::ToString(transition.refusal));
  if (!transition.detail.empty()) absl::StrAppend(&reason, ": ", transition.detail);
  outbox_.AddRefusal({.id = it->second,
                      .from = table.name(transition.from),
                      .to = table.name(transition.to),
                      .cause = CauseText(transition.cause),
                      .reason = std::move(reason),
                      .count = effect.count,
                      .time_unix_ns = transition.at.unix_ns,
                      .trace = CopyOf(effect.trace)});
}

void Decider::Adopt(levels::LevelIndex level, const DecisionId& seen, const std::string& why) {
  levels::Transition transition = state_.level.Adopt(level, seen, context_.now());
  transition.cause.reason = why;
  OnTransition({.transition = std::move(transition)});
}

void Decider::Resume() {
  budget_spent_ = false;
  state_.level.Resume();
  state_.Resume();
}

void Decider::OnDurable(const levels::Transition& lowering) {
  outbox_.Release(lowering.decision_id);
  // A raise may have been decided meanwhile: then that one has been commanded already.
  if (lowering.decision_id != state_.level.decision_id()) return;
  if (lowering.cause.kind == levels::Cause::Kind::kRule && lowering.lowers()) {
    // What a rule saw must hold until its lowering leaves. It is the newest decision, which began
    // evidence anew.
    if (!evidence_.broken_by().empty()) {
      return TakeBack(lowering, engine::Severity::kMedium,
                      absl::StrCat("while it was recorded, ", evidence_.broken_by()));
    }
  }
  actuators_.Order(lowering, CauseText(lowering.cause));
}

void Decider::TakeBack(const levels::Transition& lowering, engine::Severity severity,
                       std::string why) {
  const std::string text = absl::StrCat("a lowering was taken back: ", std::move(why));
  if (auto answer = orders_.Refuse(lowering.decision_id, absl::FailedPreconditionError(text))) {
    context_.Do(*std::move(answer));
  }
  outbox_.Release(lowering.decision_id);
  if (state_.level.level() >= lowering.from) return;
  alerts_.Raise(severity, text);
  Adopt(lowering.from, state_.level.decision_id(), text);
}

}  // namespace rips::pipeline
