#include "policy_server/policy/replay/replayer.h"

#include <algorithm>
#include <utility>
#include <variant>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "services/base/check.h"
#include "services/base/overloaded.h"
#include "services/base/status_macros.h"

namespace rips::replay {
namespace {

using engine::RuleObserver;
using recording::Recorded;
using recording::RecordedGraph;
using recording::RecordedMessage;

lang::EventClass ClassOf(const engine::Event& event) {
  if (std::holds_alternative<engine::MessageEvent>(event.what)) return lang::EventClass::kMsg;
  if (std::holds_alternative<engine::GraphEvent>(event.what)) return lang::EventClass::kGraph;
  return lang::EventClass::kExternal;
}

absl::Status AtEvent(uint64_t event, const absl::Status& status) {
  return absl::Status(status.code(), absl::StrCat("event ", event, ": ", status.message()));
}

// Of two times in range.
int64_t After(int64_t time_ns, int64_t by_ns) {
  return by_ns > kTimeNsMax - time_ns ? kTimeNsMax + 1 : time_ns + by_ns;
}

// What a recording lacks, by the events around it.
class MissingParts {
 public:
  void OnEvent(const Recorded& event) {
    last_ = {.event = event.index, .time_ns = event.time_unix_ns.value_or(0)};
    if (!first_ns_.has_value()) first_ns_ = last_->time_ns;
  }
  void Note(absl::string_view what, bool end) {
    list_.push_back({.after = last_,
                     .after_ns = last_.has_value() ? last_->time_ns - *first_ns_ : 0,
                     .end = end,
                     .text = std::string(what)});
  }
  bool any_event() const { return last_.has_value(); }
  std::vector<Missing> list() && { return std::move(list_); }

 private:
  std::optional<int64_t> first_ns_;
  std::optional<Moment> last_;
  std::vector<Missing> list_;
};

}  // namespace

// The robot's answers.
class Replayer::Script final : public engine::ScriptedRobot {
 public:
  explicit Script(const ReplayOptions& options) : options_(options) {}
  bool RunProgram(absl::string_view program, const std::vector<std::string>&) override {
    return !options_.failing_programs.contains(program);
  }
  bool Reach(levels::LevelIndex level) override { return !options_.failing_levels.contains(level); }

 private:
  const ReplayOptions& options_;  // Not owned; outlives this.
};

class Replayer::Observer final : public RuleObserver {
 public:
  explicit Observer(Replayer& replayer) : replayer_(replayer) {}

  void OnRule(uint32_t rule, RuleResult came, absl::string_view what) override {
    last_ = rule;
    RuleHits& hits = replayer_.result_.rules[rule];
    if (came == RuleResult::kFired || came == RuleResult::kFiredUnscanned) ++hits.fired;
    if (came == RuleResult::kUnscanned || came == RuleResult::kFiredUnscanned) ++hits.unscanned;
    if (came == RuleResult::kUndecidable) ++hits.undecidable;
    if (what == engine::kGraphTruncated) {
      ++hits.graph_truncated;
    } else if (!what.empty()) {
      replayer_.Keep(replayer_.result_.faults,
                     {.at = replayer_.now_, .rule = hits.name, .text = std::string(what)});
    }
    if (const Clock* clock = replayer_.options_.profile_clock) {
      const int64_t now_ns = clock->Now().boottime_ns;
      hits.total_ns += now_ns - since_ns_;
      since_ns_ = now_ns;
    }
  }
  void Start() {
    const Clock* clock = replayer_.options_.profile_clock;
    if (clock != nullptr) since_ns_ = clock->Now().boottime_ns;
  }
  // The rule that was run last.
  uint32_t last() const { return last_; }

 private:
  Replayer& replayer_;  // Not owned; outlives this.
  int64_t since_ns_ = 0;
  uint32_t last_ = 0;
};

Replayer::Replayer(std::shared_ptr<const engine::CompiledPolicy> program, ReplayOptions options,
                   inspect::Session* session)
    : program_(std::move(program)),
      options_(std::move(options)),
      session_(session),
      script_(std::make_unique<Script>(options_)),
      observer_(std::make_unique<Observer>(*this)),
      state_(program_,
             levels::LevelMachine(program_->rules().levels, options_.start_level,
                                  /*decision_id=*/{1, 1}, /*term=*/1),
             /*started=*/{.boottime_ns = -options_.uptime_ns}) {
  RIPS_CHECK(options_.event_interval_ns >= 0 && options_.tick_ns >= 0, "times do not go back");
  state_.scripted = script_.get();
  state_.observer = observer_.get();
  state_.graph_known = options_.graph_known;
  state_.robot_id = options_.robot;
  for (const lang::TypedRule& rule : program_->rules().rules) {
    result_.rules.push_back({.name = rule.name, .section = rule.section});
  }
}

Replayer::~Replayer() = default;

void Replayer::SetVariables(const absl::btree_map<std::string, lang::Value>& values) {
  state_.RestoreVariables(values);
}

absl::Status Replayer::Judge(const Recorded& event) {
  int64_t time_ns = event.time_unix_ns.value_or(
      times_.first_ns.has_value() ? After(times_.last_ns, options_.event_interval_ns) : 0);
  if (time_ns < 0 || time_ns > kTimeNsMax) {
    return absl::InvalidArgumentError(absl::StrCat("event ", event.index, ": time ", time_ns,
                                                   " ns is not from 0 to ", kTimeNsMax));
  }
  result_.timed |= event.time_unix_ns.has_value();
  if (const absl::Status ticks = TicksUntil(time_ns); !ticks.ok()) {
    return AtEvent(event.index, ticks);
  }
  times_.last_ns = time_ns;
  SetTime(event.index, time_ns);
  times_.lateness = event.late ? levels::Lateness::kLate : levels::Lateness::kTimely;
  if (event.blind.has_value()) SetEvidence(!*event.blind);
  if (event.findings.has_value()) SetFindings(*event.findings);
  if (event.context.has_value()) {
    if (const absl::Status taken = TakeGraph(*event.context); !taken.ok()) {
      return AtEvent(event.index, taken);
    }
    state_.graph = graph_;
  }
  absl::Status judged;
  std::visit(Overloaded{[&](const RecordedMessage& message) { JudgeMessage(message); },
                        [&](const RecordedGraph& graph) {
                          judged = AtEvent(event.index, JudgeGraph(graph));
                        },
                        [&](const model::ExternalEvent& external) { JudgeExternal(external); },
                        [&](const recording::RecordedLevel& level) { SetLevel(level); },
                        [](const recording::RecordedOther&) {}},
             event.what);
  times_.lateness = levels::Lateness::kTimely;
  return judged;
}

absl::Status Replayer::TicksUntil(int64_t time_ns) {
  if (options_.tick_ns == 0) return absl::OkStatus();
  if (!times_.first_ns.has_value()) {
    times_.next_tick_ns = After(time_ns, options_.tick_ns);
    return absl::OkStatus();
  }
  if (times_.next_tick_ns <= time_ns &&
      (time_ns - times_.next_tick_ns) / options_.tick_ns >= kTicksBetweenEventsMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat("it comes ", (time_ns - times_.last_ns) / kNanosPerSecond,
                     " s after the event before it, which is more than ", kTicksBetweenEventsMax,
                     " virtual ticks; make them rarer"));
  }
  for (; times_.next_tick_ns <= time_ns;
       times_.next_tick_ns = After(times_.next_tick_ns, options_.tick_ns)) {
    JudgeTick(now_.event, times_.next_tick_ns);
  }
  return absl::OkStatus();
}

void Replayer::SetTime(uint64_t event, int64_t time_ns) {
  if (!times_.first_ns.has_value()) times_.first_ns = time_ns;
  times_.elapsed_ns = std::max(times_.elapsed_ns, time_ns - *times_.first_ns);
  now_ = {.event = event, .time_ns = time_ns};
}

void Replayer::JudgeTick(uint64_t event, int64_t time_ns) {
  SetTime(event, time_ns);
  JudgeExternal(engine::TickEvent{});
}

void Replayer::Order(uint64_t event, int64_t time_ns, bool raise, levels::LevelIndex to) {
  SetTime(event, time_ns);
  const Instant now{.boottime_ns = times_.elapsed_ns, .unix_ns = now_.time_ns};
  const levels::Cause cause{.kind = levels::Cause::Kind::kOperator, .name = kOperatorName};
  levels::LevelMachine& level = state_.level;
  Take(raise ? level.Raise(to, cause, now)
             : level.DeEscalate(to, cause, now, level.level(), level.decision_id()));
}

void Replayer::SetLevel(const recording::RecordedLevel& level) {
  const std::optional<levels::LevelIndex> to = program_->rules().levels.Find(level.to);
  if (!to.has_value()) {
    return Keep(result_.faults, {.at = now_,
                                 .rule = level.cause,
                                 .text = absl::StrCat("set the level `", level.to,
                                                      "`, which the rules do not have")});
  }
  if (*to != state_.level.level()) {
    Order(now_.event, now_.time_ns, *to > state_.level.level(), *to);
  }
}

void Replayer::SetEvidence(bool complete) {
  state_.evidence = {};
  if (!complete) state_.evidence.blind_because = {"evidence is not complete"};
}

absl::Status Replayer::TakeGraph(const RecordedGraph& graph) {
  if (graph.whole) {
    graph_.Clear();
    settled_ = graph.settled;
  }
  settled_ |= graph.settled;
  return graph_.Apply(graph.content);
}

absl::Status Replayer::JudgeGraph(const RecordedGraph& graph) {
  RIPS_RETURN_IF_ERROR(TakeGraph(graph));
  if (!settled_) return absl::OkStatus();
  state_.graph = graph_;
  Run({.what = engine::GraphEvent{}, .time_unix_ns = now_.time_ns, .lateness = times_.lateness});
  return absl::OkStatus();
}

void Replayer::JudgeMessage(const RecordedMessage& message) {
  absl::string_view sender = message.sender;
  if (sender.empty()) {
    const ros2::Endpoint* endpoint = state_.graph->FindEndpoint(message.writer);
    if (endpoint != nullptr) sender = endpoint->node;
  }
  if (sender.empty()) {
    ++result_.events.unattributed;
    if (message.writer.none()) ++result_.events.unattributed_writer;
  }
  engine::Event event{.what = engine::MessageEvent{.topic = message.topic,
                                                   .type = message.type,
                                                   .writer = message.writer,
                                                   .sender = sender,
                                                   .size_bytes = message.size_bytes},
                      .time_unix_ns = now_.time_ns,
                      .lateness = times_.lateness};
  std::vector<engine::Verdict> verdicts;
  Inspect(message, event, verdicts);
  Run(event);
}

void Replayer::Inspect(const RecordedMessage& message, engine::Event& event,
                       std::vector<engine::Verdict>& verdicts) {
  const Instant now{.boottime_ns = times_.elapsed_ns, .unix_ns = now_.time_ns};
  const std::vector<uint32_t> needed = engine::NeededInspections(event, now, state_);
  if (needed.empty()) return;
  verdicts.assign(program_->rules().inspections.size(), engine::Verdict::kUnscanned);
  auto& judged = std::get<engine::MessageEvent>(event.what);
  judged.inspections = verdicts;
  if (session_ == nullptr) return;
  const std::string writer_hex = absl::BytesToHexString(message.writer.ToBytes());
  const inspect::Message asked{.robot = options_.robot,
                               .topic = message.topic,
                               .type = message.type,
                               .sender = judged.sender,
                               .writer_hex = writer_hex,
                               .time_unix_ns = now_.time_ns,
                               .payload = message.payload,
                               .size_bytes = message.size_bytes,
                               .available = !message.truncated || !message.payload.empty()};
  for (const uint32_t index : needed) verdicts[index] = session_->Inspect(index, asked);
}

void Replayer::JudgeExternal(engine::ExternalEvent external) {
  engine::Event event{.time_unix_ns = now_.time_ns, .lateness = times_.lateness};
  event.what.emplace<engine::ExternalEvent>(std::move(external));
  Run(event);
}

void Replayer::Run(const engine::Event& event) {
  const lang::EventClass event_class = ClassOf(event);
  EventCounts& counts = result_.events;
  if (event_class == lang::EventClass::kMsg) {
    ++counts.message;
  } else if (event_class == lang::EventClass::kGraph) {
    ++counts.graph;
  } else {
    ++counts.external;
  }
  if (state_.halted()) return;
  const Instant now{.boottime_ns = times_.elapsed_ns, .unix_ns = now_.time_ns};
  observer_->Start();
  const engine::Outcome outcome = engine::Evaluate(event, now, state_);
  ++judged_[static_cast<size_t>(event_class)];
  if (outcome.undecidable > 0) ++counts.undecidable;
  if (outcome.crashed) {
    result_.crashed = now_;
    crashed_rule_ = observer_->last();
  }
  Take(outcome);
}

void Replayer::CountEvaluated(Result& result) const {
  for (size_t i = 0; i < result.rules.size(); ++i) {
    RuleHits& rule = result.rules[i];
    rule.evaluated = judged_[static_cast<size_t>(rule.section)];
    // The rules after the one that crashed were not run on that event.
    const bool skipped = crashed_rule_.has_value() && i > *crashed_rule_ &&
                         rule.section == result.rules[*crashed_rule_].section;
    if (skipped) --rule.evaluated;
  }
}

void Replayer::Take(const levels::Transition& transition) {
  const levels::LevelTable& table = program_->rules().levels;
  Keep(result_.transitions, {.at = now_,
                             .rule = transition.cause.name,
                             .from = table.name(transition.from),
                             .to = table.name(transition.to),
                             .refused = transition.refused(),
                             .reason = std::string(levels::ToString(transition.refusal))});
}

void Replayer::Take(const engine::Outcome& outcome) {
  for (const engine::Effect& effect : outcome.effects) {
    if (const auto* alert = std::get_if<engine::AlertEffect>(&effect)) {
      Keep(result_.alerts,
           {.at = now_, .rule = alert->rule, .text = alert->text, .severity = alert->severity});
    } else if (const auto* change = std::get_if<engine::TransitionEffect>(&effect)) {
      Take(change->transition);
    } else if (const auto* run = std::get_if<engine::RunProgramEffect>(&effect)) {
      Keep(result_.execs, {.at = now_,
                           .rule = run->rule,
                           .program = run->program,
                           .args = run->args,
                           .ok = !options_.failing_programs.contains(run->program)});
    } else if (const auto* log = std::get_if<engine::LogEffect>(&effect)) {
      Keep(result_.logs, {.at = now_, .rule = log->rule, .text = log->text});
    }
  }
}

template <typename Record>
void Replayer::Keep(std::vector<Record>& list, Record record) {
  const size_t kept = result_.transitions.size() + result_.alerts.size() + result_.execs.size() +
                      result_.faults.size() + result_.logs.size();
  if (kept >= options_.records_max) {
    ++result_.left_out;
  } else {
    list.push_back(std::move(record));
  }
}

Records Replayer::TakeRecords() {
  return {.transitions = std::exchange(result_.transitions, {}),
          .alerts = std::exchange(result_.alerts, {}),
          .execs = std::exchange(result_.execs, {}),
          .faults = std::exchange(result_.faults, {}),
          .logs = std::exchange(result_.logs, {})};
}

std::string Replayer::crashed_rule() const {
  return crashed_rule_.has_value() ? result_.rules[*crashed_rule_].name : "";
}

std::string Replayer::level() const { return state_.level.table().name(state_.level.level()); }

Result Replayer::Finish() const {
  Result result = result_;
  CountEvaluated(result);
  result.level = level();
  result.variables = state_.Variables();
  return result;
}

absl::StatusOr<Result> Replay(recording::Reader& reader,
                              std::shared_ptr<const engine::CompiledPolicy> program,
                              ReplayOptions options, inspect::Session* session) {
  options.graph_known = reader.has_graph();
  const recording::RecordedOrigin* origin = reader.origin();
  if (origin != nullptr) {
    if (options.robot.empty()) options.robot = origin->robot;
    options.uptime_ns = origin->uptime_ns;
  }
  Replayer replayer(std::move(program), std::move(options), session);
  if (origin != nullptr) replayer.SetVariables(origin->variables);
  MissingParts missing;
  while (true) {
    const absl::StatusOr<std::optional<Recorded>> event = reader.Next();
    const bool cut = absl::IsDataLoss(event.status()) && missing.any_event();
    if (!cut) RIPS_RETURN_IF_ERROR(event.status());
    if (cut) missing.Note(event.status().message(), /*end=*/true);
    if (cut || !event->has_value()) {
      Result result = replayer.Finish();
      result.missing = std::move(missing).list();
      return result;
    }
    const Recorded& next = **event;
    if (!next.missing_before.empty()) missing.Note(next.missing_before, /*end=*/false);
    missing.OnEvent(next);
    RIPS_RETURN_IF_ERROR(replayer.Judge(next));
  }
}

}  // namespace rips::replay
