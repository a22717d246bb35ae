#include "policy_server/server/shadow/shadow_run.h"

#include <algorithm>
#include <tuple>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/engine/interest/kept_topics.h"
#include "services/base/cut_text.h"

namespace rips::shadow {
namespace {

replay::ReplayOptions OptionsOf(const ShadowPolicy& policy, const std::string& robot,
                                const pipeline::RulesState& start) {
  const levels::LevelTable& levels = policy.program->rules().levels;
  return {.start_level = levels.Find(start.level).value_or(policy.start_level),
          .robot = robot,
          .uptime_ns = start.uptime_ns,
          // They are taken after each event.
          .records_max = SIZE_MAX};
}

std::string CommandLine(const replay::Executed& exec) {
  return exec.args.empty() ? exec.program
                           : absl::StrCat(exec.program, " ", absl::StrJoin(exec.args, " "));
}

}  // namespace

std::shared_ptr<const pipeline::AlsoWatched> MakeWatched(const engine::CompiledPolicy& program,
                                                         const engine::PayloadLimits& limits) {
  auto watched = std::make_shared<pipeline::AlsoWatched>();
  watched->interest = {.plan = *pipeline::MakeInterest(program), .limits = limits};
  watched->kept_topics = engine::KeptTopics(program.rules());
  for (engine::TopicInterest& row : watched->interest.plan) {
    for (std::string& rule : row.wanted_by) absl::StrAppend(&rule, " (shadow)");
  }
  return watched;
}

ShadowPolicy PolicyOf(const bundle::Bundle& bundle) {
  return {.bundle_id = bundle.id,
          .name = bundle.manifest.name,
          .program = bundle.program,
          .start_level = bundle.start_level,
          .inspections = bundle.inspections,
          .watched = MakeWatched(*bundle.program, bundle.manifest.payload_limits)};
}

ShadowRun::ShadowRun(const ShadowPolicy& policy, const std::string& robot,
                     const pipeline::RulesState& start, inspect::Session* session)
    : bundle_id_(policy.bundle_id),
      name_(policy.name),
      program_(policy.program),
      interest_(policy.watched->interest),
      converter_(start),
      replayer_(policy.program, OptionsOf(policy, robot, start), session) {
  replayer_.SetVariables(start.variables);
}

// Would its sensors have sent it, and how many bytes of its payload?
bool ShadowRun::Asks(const pipeline::JudgedEvent& judged, size_t& payload_bytes_max) {
  if (const auto* message = std::get_if<engine::MessageEvent>(&judged.event.what)) {
    const engine::Need need = interest_.Of(message->topic);
    payload_bytes_max = need.payload_bytes;
    return need.depth != engine::Depth::kNothing;
  }
  const auto* external = std::get_if<engine::ExternalEvent>(&judged.event.what);
  const auto* loss = external == nullptr ? nullptr : std::get_if<model::Loss>(external);
  return loss == nullptr || loss->topic.empty() ||
         interest_.Of(loss->topic).depth != engine::Depth::kNothing;
}

void ShadowRun::Judge(const pipeline::JudgedEvent& judged) {
  size_t payload_bytes_max = 0;
  if (stopped() || !Asks(judged, payload_bytes_max)) return;
  ++events_;
  recording::Recorded recorded = converter_.Convert(judged, payload_bytes_max);
  absl::Status status = JudgeNow(recorded);
  if (!status.ok()) {
    converter_.Forget();
    recorded = converter_.Convert(judged, payload_bytes_max);
    status = JudgeNow(recorded);
  }
  if (!status.ok()) return Stop(absl::StrCat("it cannot judge an event: ", status.message()));
  Fold(/*by_rules=*/true);
}

void ShadowRun::Judge(const pipeline::LevelChange& level) {
  if (stopped() || !program_->rules().levels.Find(level.to).has_value()) return;
  recording::Recorded recorded = converter_.Convert(level);
  if (const absl::Status status = JudgeNow(recorded); !status.ok()) {
    return Stop(absl::StrCat("it cannot change its level: ", status.message()));
  }
  Fold(/*by_rules=*/false);
}

absl::Status ShadowRun::JudgeNow(recording::Recorded& recorded) {
  recorded.index = events_;
  recorded.time_unix_ns =
      std::clamp<int64_t>(recorded.time_unix_ns.value_or(0), 0, replay::kTimeNsMax);
  return replayer_.Judge(recorded);
}

void ShadowRun::Fold(bool by_rules) {
  const replay::Records records = replayer_.TakeRecords();
  for (const replay::Alerted& alert : records.alerts) {
    ++would_.alerts;
    AddExample(alert.at, alert.rule, "alert", alert.text);
  }
  for (const replay::Changed& change : records.transitions) {
    if (by_rules) Fold(change);
  }
  for (const replay::Executed& exec : records.execs) {
    ++would_.programs;
    AddExample(exec.at, exec.rule, "program", CommandLine(exec));
  }
  for (const replay::Noted& fault : records.faults) {
    ++would_.faults;
    AddExample(fault.at, fault.rule, "fault", fault.text);
  }
  if (replayer_.so_far().crashed.has_value()) {
    Stop(absl::StrCat("its rule ", replayer_.crashed_rule(), " has called `crash`"));
  }
}

void ShadowRun::Fold(const replay::Changed& change) {
  const std::string steps = absl::StrCat(change.from, " -> ", change.to);
  if (change.refused) {
    ++would_.refusals;
    return AddExample(change.at, change.rule, "refusal", absl::StrCat(steps, ": ", change.reason));
  }
  if (change.from == change.to) return;
  const levels::LevelTable& levels = program_->rules().levels;
  const bool raise = levels.Find(change.to) > levels.Find(change.from);
  ++(raise ? would_.raises : would_.lowerings);
  AddExample(change.at, change.rule, raise ? "raise" : "lowering", steps);
}

void ShadowRun::AddExample(const replay::Moment& at, const std::string& rule, const char* kind,
                           const std::string& text) {
  ShadowExample example{.time_unix_ns = at.time_ns,
                        .rule = Shortened(rule, kTextBytesMax),
                        .kind = kind,
                        .text = Shortened(text, kTextBytesMax)};
  if (first_.size() < kFirstExamples) return first_.push_back(std::move(example));
  if (newest_.size() >= kNewestExamples) newest_.pop_front();
  newest_.push_back(std::move(example));
}

void ShadowRun::Stop(const std::string& problem) { problem_ = Shortened(problem, kTextBytesMax); }

void ShadowRun::Report(ShadowReport& report) const {
  report.bundle_id = bundle_id_;
  report.name = name_;
  report.events = events_;
  report.problem = problem_;
  report.level = replayer_.level();
  report.would = would_;
  report.rules.clear();
  for (const replay::RuleHits& rule : replayer_.so_far().rules) {
    if (rule.fired + rule.unscanned + rule.undecidable == 0) continue;
    report.rules.push_back({.rule = rule.name,
                            .fired = rule.fired,
                            .unscanned = rule.unscanned,
                            .undecidable = rule.undecidable});
  }
  const auto by_count = [](const ShadowRule& a, const ShadowRule& b) {
    return std::tie(b.fired, b.unscanned, b.undecidable, a.rule) <
           std::tie(a.fired, a.unscanned, a.undecidable, b.rule);
  };
  const size_t kept = std::min(report.rules.size(), kRulesMax);
  const auto end = report.rules.begin() + static_cast<std::ptrdiff_t>(kept);
  std::partial_sort(report.rules.begin(), end, report.rules.end(), by_count);
  report.rules.erase(end, report.rules.end());
  report.examples = first_;
  report.examples.insert(report.examples.end(), newest_.begin(), newest_.end());
}

}  // namespace rips::shadow
